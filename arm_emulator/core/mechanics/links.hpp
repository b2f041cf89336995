// The links as the drives see them: the chain itself, where each drive moves a joint of its own.
#pragma once

#include "mechanics/coupled_links.hpp"

namespace arm {

template <class S, class X = Real>
using Links = std::conditional_t<kCoupled<S>, CoupledLinks<S, X>, LinkChain<S, X>>;

}  // namespace arm
