// SPDX-License-Identifier: GPL-3.0-or-later
// Takes the place of fourier_transform.cc in builds without FFTW.
#include "fourier_transform.h"

#include "mixed_radix.h"

#include <vector>

namespace gr::wiforce::kernel {

struct fourier_transform::plan {
    explicit plan(int length) : input(length), output(length), transform(length) {}

    std::vector<fc32> input, output;
    mixed_radix transform;
};

fourier_transform::fourier_transform(int length)
    : d_length(length), d_plan(std::make_unique<plan>(length))
{
}

fourier_transform::~fourier_transform() = default;

fc32* fourier_transform::input() { return d_plan->input.data(); }

const fc32* fourier_transform::execute()
{
    d_plan->transform.execute(d_plan->input.data(), d_plan->output.data());
    return d_plan->output.data();
}

} // namespace gr::wiforce::kernel
