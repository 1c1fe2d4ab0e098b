// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <vector>

namespace gr::wiforce::kernel {

// Inverse of a symmetric positive definite matrix, n x n row by row. Of a matrix that is
// singular within the accuracy of a fit, the pseudo-inverse. `singular`: largest energy
// of a column over what the others leave of one, from which on it is.
std::vector<double>
inverse_of(const std::vector<double>& matrix, std::size_t n, double singular = 1e12);

} // namespace gr::wiforce::kernel
