// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <complex>
#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Inverse of a Hermitian positive definite matrix, n x n row by row. Of a matrix that is
// singular within the accuracy of a fit, the pseudo-inverse.
std::vector<std::complex<double>>
inverse_of(const std::vector<std::complex<double>>& matrix, std::size_t n);

} // namespace gr::wiforce::kernel
