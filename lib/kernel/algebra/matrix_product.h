// SPDX-License-Identifier: GPL-3.0-or-later
// Products of small matrices, in tiles whose sums stay in registers: a sum in memory
// costs a load and a store for each product. The left factor is real; complex columns of
// the right one are two real ones. For functions with WIFORCE_CLONES, into which all of
// it is inlined.
#pragma once

#include <algorithm>
#include <complex>
#include <cstddef>
#include <cstring>
#include <vector>

namespace gr::wiforce::kernel {

// The left factor of a product: its elements at `row` and `column` distances, times
// `sign`, and whether it is lower triangular.
struct left_factor {
    const double* values;
    std::size_t row, column;
    double sign = 1;
    bool triangular = false;
};

namespace tiles {

constexpr std::size_t rows = 4, vectors = 2; // of a tile: 8 sums, as registers allow
using four = double __attribute__((vector_size(32)));

// to += factors x from, of Rows rows and Vectors times four columns.
template <std::size_t Rows, std::size_t Vectors>
inline __attribute__((always_inline)) void add_tile(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    four sums[Rows][Vectors]{};
    for (std::size_t i = 0; i < depth; i++, factors += rows, from += columns)
        for (std::size_t v = 0; v < Vectors; v++) {
            four values;
            std::memcpy(&values, from + 4 * v, sizeof values);
            for (std::size_t row = 0; row < Rows; row++)
                sums[row][v] += factors[row] * values;
        }
    for (std::size_t row = 0; row < Rows; row++, to += columns)
        for (std::size_t v = 0; v < Vectors; v++)
            for (std::size_t i = 0; i < 4; i++)
                to[4 * v + i] += sums[row][v][i];
}

template <std::size_t Rows>
inline __attribute__((always_inline)) void add_rows(const double* factors,
                                                    std::size_t depth,
                                                    const double* from,
                                                    std::size_t columns,
                                                    double* to)
{
    std::size_t column = 0;
    for (; column + 4 * vectors <= columns; column += 4 * vectors)
        add_tile<Rows, vectors>(factors, depth, from + column, columns, to + column);
    for (; column + 4 <= columns; column += 4)
        add_tile<Rows, 1>(factors, depth, from + column, columns, to + column);
    for (; column < columns; column++)
        for (std::size_t row = 0; row < Rows; row++) {
            double sum = 0;
            for (std::size_t i = 0; i < depth; i++)
                sum += factors[i * rows + row] * from[i * columns + column];
            to[row * columns + column] += sum;
        }
}

} // namespace tiles

// to += left x right; left is count x depth, right depth x columns, row by row.
inline __attribute__((always_inline)) void add_product(const left_factor& left,
                                                       std::size_t count,
                                                       std::size_t depth,
                                                       const double* right,
                                                       std::size_t columns,
                                                       double* to,
                                                       std::vector<double>& packed)
{
    packed.resize(tiles::rows * depth);
    for (std::size_t row = 0; row < count;) {
        const std::size_t rows = count - row >= tiles::rows ? tiles::rows
                                 : count - row >= 2         ? 2
                                                            : 1;
        const std::size_t used = left.triangular ? std::min(depth, row + rows) : depth;
        for (std::size_t i = 0; i < used; i++)
            for (std::size_t each = 0; each < rows; each++)
                packed[i * tiles::rows + each] =
                    left.sign * left.values[(row + each) * left.row + i * left.column];
        double* const sums = to + row * columns;
        if (rows == tiles::rows)
            tiles::add_rows<tiles::rows>(packed.data(), used, right, columns, sums);
        else if (rows == 2)
            tiles::add_rows<2>(packed.data(), used, right, columns, sums);
        else
            tiles::add_rows<1>(packed.data(), used, right, columns, sums);
        row += rows;
    }
}

// The same of complex columns.
inline __attribute__((always_inline)) void add_product(const left_factor& left,
                                                       std::size_t count,
                                                       std::size_t depth,
                                                       const std::complex<double>* right,
                                                       std::size_t columns,
                                                       std::complex<double>* to,
                                                       std::vector<double>& packed)
{
    add_product(left,
                count,
                depth,
                reinterpret_cast<const double*>(right),
                2 * columns,
                reinterpret_cast<double*>(to),
                packed);
}

// to = lower x right, with a lower triangular matrix (count x count).
template <class T>
inline __attribute__((always_inline)) void triangular_product(
    const double* lower, std::size_t count, const T* right, std::size_t columns, T* to)
{
    std::vector<double> packed;
    std::fill_n(to, count * columns, 0.0);
    add_product({ lower, count, 1, 1, true }, count, count, right, columns, to, packed);
}

} // namespace gr::wiforce::kernel
