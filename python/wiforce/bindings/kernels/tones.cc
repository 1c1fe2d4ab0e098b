// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/doppler/tone_accumulator.h>
#include <kernel/doppler/tone_channel.h>

#include <pybind11/stl.h>

#include <algorithm>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

using complex_array = array<std::complex<double>>;

int columns_of(const complex_array& weights)
{
    if (weights.ndim() != 2)
        throw std::invalid_argument(
            "tone_transform: weights must have 2 dimensions, tones x snapshots, got " +
            std::to_string(weights.ndim()));
    return weights.shape(1);
}

class tone_transform
{
public:
    tone_transform(const complex_array& weights,
                   const complex_array& factors,
                   const complex_array& rotation,
                   const std::vector<int>& bins)
        : d_group(columns_of(weights), factors.size()),
          d_accumulator(flat(weights), weights.shape(1), factors.size()),
          d_channel(flat(factors), d_accumulator.rows(), flat(rotation), bins),
          d_transform(std::size_t(d_accumulator.rows()) * factors.size())
    {
    }

    py::array_t<fc32> transform(const array<fc32>& folded)
    {
        const int length = d_group.length();
        if (folded.ndim() != 2 || folded.shape(0) != length ||
            folded.shape(1) != d_group.symbol_length())
            throw std::invalid_argument("tone_transform: folded must have shape (" +
                                        std::to_string(length) + ", " +
                                        std::to_string(d_group.symbol_length()) + ")");
        std::vector<fc32> tones;
        {
            py::gil_scoped_release others_may_run;
            d_group.clear();
            std::copy_n(folded.data(), folded.size(), d_group.reserve(0));
            d_group.accept(length);
            if (!d_group.is_complete())
                throw std::invalid_argument("tone_transform: folded must be finite");
            d_accumulator.clear();
            d_accumulator.finish(d_group, d_transform.data());
            d_channel.append(d_transform.data(), tones);
        }
        const py::ssize_t rows = d_accumulator.rows(), bins = d_channel.bins().size();
        return py::array_t<fc32>({ rows, bins }, tones.data());
    }

private:
    phase_group d_group;
    tone_accumulator d_accumulator;
    tone_channel d_channel;
    std::vector<fc32> d_transform; // rows x symbol_length
};

} // namespace

void bind_tones(py::module& m)
{
    py::class_<tone_transform>(
        m,
        "tone_transform",
        "Computes the channel at each tone of complete phase groups, "
        "as tone_reader does.\n\n"
        "weights: (M, N) tones x snapshots of a group. factors: (L,), "
        "1 / (X_k L / sqrt K),\nL samples of the symbol.\n"
        "rotation: (M, L), or empty for none. bins: (K,) FFT bins to "
        "keep.")
        .def(py::init<const complex_array&,
                      const complex_array&,
                      const complex_array&,
                      const std::vector<int>&>(),
             "weights"_a,
             "factors"_a,
             "rotation"_a,
             "bins"_a)
        .def("transform",
             &tone_transform::transform,
             "folded"_a,
             "folded: (N, L) complex64, the snapshots of one group. Gives (M, K) "
             "complex64.\nReleases the GIL.");
}
