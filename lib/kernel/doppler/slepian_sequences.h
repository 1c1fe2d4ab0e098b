// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// The first `order` discrete prolate spheroidal sequences of a length N and a half
// bandwidth NW, order x N, of norm 1 and orthogonal; signs are undefined. They are the
// eigenvectors of a tridiagonal matrix (D. Slepian, Bell System Technical Journal 57,
// 1978, section 2.2, equation 14), which are found by bisection and inverse iteration.
std::vector<double>
slepian_sequences(std::size_t length, double half_bandwidth, std::size_t order);

} // namespace gr::wiforce::kernel
