// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/screening/interference_screen.h>

#include <algorithm>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

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

void bind_screening(py::module& m)
{
    py::class_<group_screen>(
        m, "interference_screen", "Group by group, as the kernels for one antenna do.")
        .def(py::init<int, int>(), "group_length"_a, "symbol_length"_a = 64)
        .def("examine",
             &group_screen::examine,
             "present"_a,
             "folded"_a,
             "noise"_a,
             "present: (N,). folded: (n, L) and noise: (n, 2) of the present snapshots.\n"
             "Gives (N,), true where rejected. Releases the GIL.");
}
