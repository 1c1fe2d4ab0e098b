// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/doppler/doppler_transform.h>
#include <kernel/doppler/interference_screen.h>
#include <kernel/fold/sample_loops.h>
#include <kernel/fourier/channel_equalizer.h>

#include <algorithm>

using namespace gr::wiforce::kernel;

namespace {

class tone_transform
{
public:
    tone_transform(const complex_array& weights,
                   const complex_array& factors,
                   const complex_array& rotation,
                   const std::vector<int>& bins)
        : d_length(columns_of(weights)),
          d_accumulator(flat(weights), d_length, factors.size()),
          d_channel(flat(factors), d_accumulator.rows(), flat(rotation), bins),
          d_transform(std::size_t(d_accumulator.rows()) * factors.size())
    {
    }

    py::array_t<fc32> transform(const array<fc32>& folded)
    {
        if (folded.ndim() != 2 || folded.shape(0) != d_length ||
            folded.shape(1) != d_channel.symbol_length())
            throw std::invalid_argument("tone_transform: folded must have shape (" +
                                        std::to_string(d_length) + ", " +
                                        std::to_string(d_channel.symbol_length()) + ")");
        const py::ssize_t rows = d_accumulator.rows(), bins = d_channel.bins().size();
        py::array_t<fc32> tones({ rows, bins });
        fc32* const out = tones.mutable_data();
        {
            py::gil_scoped_release others_may_run;
            d_accumulator.transform(folded.data(), d_transform.data());
            // A sum with something that is not finite is not finite either.
            if (!are_finite(reinterpret_cast<const float*>(d_transform.data()),
                            2 * d_transform.size()))
                throw std::invalid_argument("tone_transform: folded must be finite");
            d_channel.write(d_transform.data(), out);
        }
        return tones;
    }

private:
    const int d_length; // snapshots of a group
    tone_accumulator d_accumulator;
    channel_equalizer d_channel;
    std::vector<fc32> d_transform; // rows x symbol_length
};

class group_screen
{
public:
    group_screen(int group_length, int symbol_length)
        : d_group(group_length, symbol_length), d_screen(group_length, symbol_length)
    {
    }

    py::object examine(const array<bool>& present,
                       const array<std::complex<float>>& folded,
                       const array<float>& noise)
    {
        const auto received =
            std::count(present.data(), present.data() + present.size(), true);
        const int length = d_group.symbol_length();
        if (present.size() != d_group.length() || folded.size() != received * length ||
            noise.size() != 2 * received)
            throw std::invalid_argument("interference_screen: present must have "
                                        "group_length values, folded " +
                                        std::to_string(length) +
                                        " and noise 2 for each snapshot that is present");
        const auto noises = structures<snapshot_noise>(noise);
        py::array_t<std::uint8_t> marks(present.size());
        {
            py::gil_scoped_release others_may_run;
            d_group.clear();
            const fc32* from = folded.data();
            for (int n = 0, row = 0; n < d_group.length(); n++)
                if (present.data()[n]) {
                    fc32* const slot = d_group.reserve(n);
                    std::copy_n(from, length, slot);
                    *d_group.noise() = noises[row++];
                    note_values_not_finite(slot, 1, length, d_group.noise());
                    d_group.accept(1);
                    from += length;
                }
            d_group.finish();
            const auto& found = d_screen.examine(d_group);
            std::copy(found.begin(), found.end(), marks.mutable_data());
        }
        return marks.attr("view")("bool");
    }

private:
    phase_group d_group;
    interference_screen d_screen;
};

} // namespace

void bind_tones(py::module& m)
{
    py::class_<tone_transform>(
        m,
        "tone_transform",
        "tone_reader for complete groups of a stream; arguments likewise.")
        .def(py::init<const complex_array&,
                      const complex_array&,
                      const complex_array&,
                      const std::vector<int>&>())
        .def("transform",
             &tone_transform::transform,
             "folded: (N, L). Gives (M, K). Releases the GIL.");
    py::class_<group_screen>(
        m, "interference_screen", "Group by group, as the kernels for one antenna do.")
        .def(py::init<int, int>())
        .def("examine",
             &group_screen::examine,
             R"(present: (N,). folded: (n, L) and noise: (n, 2) of the present snapshots.
Gives (N,), true where rejected. Releases the GIL.)");
}
