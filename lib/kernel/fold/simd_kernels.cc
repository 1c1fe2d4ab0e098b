// SPDX-License-Identifier: GPL-3.0-or-later
#include "simd_kernels.h"

namespace gr::wiforce::kernel {

namespace generic {
extern const simd_kernels kernels;
}
#ifdef WIFORCE_X86
namespace avx2 {
extern const simd_kernels kernels;
}
namespace avx512 {
extern const simd_kernels kernels;
}
#endif

std::vector<const simd_kernels*> usable_kernels()
{
    std::vector<const simd_kernels*> usable = { &generic::kernels };
#ifdef WIFORCE_X86
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma"))
        usable.push_back(&avx2::kernels);
    if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        usable.push_back(&avx512::kernels);
#endif
    return usable;
}

const simd_kernels& fastest_kernels()
{
    static const simd_kernels& fastest = *usable_kernels().back();
    return fastest;
}

} // namespace gr::wiforce::kernel
