// Included last in the unit of kernels.
#pragma once

#ifdef __CUDA__
#pragma clang force_cuda_host_device end
#endif
