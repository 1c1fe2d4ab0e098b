// SPDX-License-Identifier: GPL-3.0-or-later
#include "group_weights.h"

#include "../clones.h"
#include "matrix_product.h"

#include <algorithm>

namespace gr::wiforce::kernel {

template <class T>
WIFORCE_CLONES void parts_of(const std::complex<T>* tones,
                             std::size_t count,
                             std::size_t subcarriers,
                             complex* parts)
{
    const auto* const from = reinterpret_cast<const T*>(tones);
    auto* const to = reinterpret_cast<double*>(parts);
    const std::size_t row = 2 * subcarriers;
    for (std::size_t pair = 0; pair < count / 2; pair++) {
        const T* const upper = from + (count / 2 + pair) * row;
        const T* const lower = from + (count / 2 - 1 - pair) * row;
        double* const first = to + 2 * pair * row;
        double* const second = first + row;
        for (std::size_t i = 0; i < row; i++)
            first[i] = (double(upper[i]) + lower[i]) / 2;
        for (std::size_t i = 0; i < row; i += 2) {
            second[i] = (double(upper[i + 1]) - lower[i + 1]) / 2;
            second[i + 1] = (double(lower[i]) - upper[i]) / 2;
        }
    }
}

template void parts_of(const std::complex<float>*, std::size_t, std::size_t, complex*);
template void parts_of(const complex*, std::size_t, std::size_t, complex*);

WIFORCE_CLONES
void tone_of(const complex* parts,
             std::size_t row,
             std::size_t count,
             std::size_t subcarriers,
             complex* tone)
{
    const auto [pair, sign] = pair_of(row, count);
    const auto* const first = parts + 2 * pair * subcarriers;
    const auto* const second = first + subcarriers;
    for (std::size_t k = 0; k < subcarriers; k++)
        tone[k] = { first[k].real() - sign * second[k].imag(),
                    first[k].imag() + sign * second[k].real() };
}

WIFORCE_CLONES
double whiten(const double* whitener,
              const complex* parts,
              std::size_t count,
              std::size_t subcarriers,
              complex* white)
{
    triangular_product(whitener, count, parts, subcarriers, white);
    return power_of(white, count * subcarriers) /
           double(std::max<std::size_t>(count * subcarriers, 1));
}

const std::vector<double>& group_weights::colorer() const
{
    const std::size_t n = tones();
    if (!d_colorer.empty() || !n)
        return d_colorer;
    // Row by row from those above: each is what the row of the whitener leaves of 1.
    d_colorer.resize(n * n);
    for (std::size_t row = 0; row < n; row++) {
        auto* const found = &d_colorer[row * n];
        found[row] = 1.0;
        for (std::size_t above = 0; above < row; above++)
            for (std::size_t column = 0; column <= above; column++)
                found[column] -=
                    d_whitener[row * n + above] * d_colorer[above * n + column];
        for (std::size_t column = 0; column <= row; column++)
            found[column] /= d_whitener[row * n + row];
    }
    return d_colorer;
}

} // namespace gr::wiforce::kernel
