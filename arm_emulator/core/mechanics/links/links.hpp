// The links as the drives see them: the tree itself, where each drive moves a joint of its own.
#pragma once

#include "mechanics/links/coupled_links.hpp"

namespace arm {

template <class S, class X = Real>
using Links = std::conditional_t<kCoupled<S>, CoupledLinks<S, X>, LinkTree<S, X>>;

}  // namespace arm
