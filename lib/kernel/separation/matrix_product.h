// SPDX-License-Identifier: GPL-3.0-or-later
// Products of small complex matrices, in tiles whose sums stay in registers: a sum in
// memory costs a load and a store for each product. For functions with WIFORCE_CLONES,
// into which all of it is inlined.
#pragma once

#include <algorithm>
#include <complex>
#include <cstddef>
#include <cstring>
#include <vector>

namespace gr::wiforce::kernel {

// The left factor of a product: its elements at `row` and `column` distances, times
// `sign`, conjugated or not, and whether it is lower triangular.
struct left_factor {
    const std::complex<double>* values;
    std::size_t row, column;
    double sign = 1;
    bool conjugate = false, triangular = false;
};

namespace tiles {

constexpr std::size_t rows = 2, vectors = 2; // of a tile: 8 sums, as registers allow
using two = double __attribute__((vector_size(32))); // complex numbers

// to += factors x from, of Rows rows and Vectors pairs of columns.
template <std::size_t Rows, std::size_t Vectors>
inline __attribute__((always_inline)) void add_tile(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    two real[Rows][Vectors]{}, imag[Rows][Vectors]{};
    for (std::size_t i = 0; i < depth; i++, factors += 2 * rows, from += 2 * columns)
        for (std::size_t v = 0; v < Vectors; v++) {
            two values;
            std::memcpy(&values, from + 4 * v, sizeof values);
            for (std::size_t row = 0; row < Rows; row++) {
                real[row][v] += factors[2 * row] * values;
                imag[row][v] += factors[2 * row + 1] * values;
            }
        }
    for (std::size_t row = 0; row < Rows; row++, to += 2 * columns)
        for (std::size_t v = 0; v < Vectors; v++)
            for (std::size_t i = 0; i < 4; i += 2) {
                to[4 * v + i] += real[row][v][i] - imag[row][v][i + 1];
                to[4 * v + i + 1] += real[row][v][i + 1] + imag[row][v][i];
            }
}

template <std::size_t Rows>
inline __attribute__((always_inline)) void add_rows(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    std::size_t column = 0;
    for (; column + 2 * vectors <= columns; column += 2 * vectors)
        add_tile<Rows, vectors>(
            factors, depth, from + 2 * column, columns, to + 2 * column);
    for (; column + 2 <= columns; column += 2)
        add_tile<Rows, 1>(factors, depth, from + 2 * column, columns, to + 2 * column);
    for (; column < columns; column++)
        for (std::size_t row = 0; row < Rows; row++) {
            double real = 0, imag = 0;
            for (std::size_t i = 0; i < depth; i++) {
                const double* const factor = factors + 2 * (i * rows + row);
                const double* const value = from + 2 * (i * columns + column);
                real += factor[0] * value[0] - factor[1] * value[1];
                imag += factor[0] * value[1] + factor[1] * value[0];
            }
            to[2 * (row * columns + column)] += real;
            to[2 * (row * columns + column) + 1] += imag;
        }
}

} // namespace tiles

// to += left x right; left is count x depth, right depth x columns, row by row.
inline __attribute__((always_inline)) void add_product(const left_factor& left,
                                                       std::size_t count,
                                                       std::size_t depth,
                                                       const std::complex<double>* right,
                                                       std::size_t columns,
                                                       std::complex<double>* to,
                                                       std::vector<double>& packed)
{
    packed.resize(2 * tiles::rows * depth);
    const double imag = left.conjugate ? -left.sign : left.sign;
    for (std::size_t row = 0; row < count; row += tiles::rows) {
        const std::size_t rows = std::min(tiles::rows, count - row);
        const std::size_t used = left.triangular ? std::min(depth, row + rows) : depth;
        for (std::size_t i = 0; i < used; i++)
            for (std::size_t each = 0; each < rows; each++) {
                const auto& value =
                    left.values[(row + each) * left.row + i * left.column];
                packed[2 * (i * tiles::rows + each)] = left.sign * value.real();
                packed[2 * (i * tiles::rows + each) + 1] = imag * value.imag();
            }
        const auto* const from = reinterpret_cast<const double*>(right);
        auto* const sums = reinterpret_cast<double*>(to + row * columns);
        if (rows == tiles::rows)
            tiles::add_rows<tiles::rows>(packed.data(), used, from, columns, sums);
        else
            tiles::add_rows<1>(packed.data(), used, from, columns, sums);
    }
}

} // namespace gr::wiforce::kernel
