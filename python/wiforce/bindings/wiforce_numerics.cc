// SPDX-License-Identifier: GPL-3.0-or-later
// Kernels for the numpy rooms: nothing here needs GNU Radio's runtime.
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>

#include <kernel/likelihood_profile.h>

namespace py = pybind11;
using namespace py::literals;
using gr::wiforce::kernel::likelihood_profile;

template <class T>
using array = py::array_t<T, py::array::c_style | py::array::forcecast>;

template <class T>
static std::vector<T> flat(const array<T>& values)
{
    return { values.data(), values.data() + values.size() };
}

// Readings (n, 9) in the order of likelihood_profile::reading.
static py::array_t<double> read_all(const likelihood_profile& profile,
                                    const array<std::int64_t>& rows,
                                    const array<double>& offset_deg,
                                    const array<double>& variance_deg2)
{
    constexpr py::ssize_t size = sizeof(likelihood_profile::reading) / sizeof(double);
    const py::ssize_t count = rows.size();
    if (offset_deg.size() != 2 * count || variance_deg2.size() != 2 * count)
        throw std::invalid_argument(
            "offset_deg and variance_deg2 must have shape (n, 2)");
    py::array_t<double> readings({ count, size });
    auto* out = reinterpret_cast<likelihood_profile::reading*>(readings.mutable_data());
    for (py::ssize_t i = 0; i < count; i++) {
        const auto row = static_cast<std::size_t>(rows.data()[i]);
        if (row >= profile.rows())
            throw std::out_of_range("no such row");
        out[i] = profile.read(row,
                              offset_deg.data()[2 * i],
                              offset_deg.data()[2 * i + 1],
                              variance_deg2.data()[2 * i],
                              variance_deg2.data()[2 * i + 1]);
    }
    return readings;
}

static py::tuple read_one(const likelihood_profile& profile,
                          std::size_t row,
                          double offset_1,
                          double offset_2,
                          double noise_1,
                          double noise_2)
{
    if (row >= profile.rows())
        throw std::out_of_range("no such row");
    const auto r = profile.read(row, offset_1, offset_2, noise_1, noise_2);
    return py::make_tuple(r.force,
                          r.location,
                          r.force_variance,
                          r.location_variance,
                          r.covariance,
                          r.misfit,
                          r.hidden,
                          r.outside,
                          r.ambiguous);
}

PYBIND11_MODULE(wiforce_numerics, m)
{
    py::class_<likelihood_profile>(
        m,
        "likelihood_profile",
        "Two phases to force and location; see sensor/profile.py.")
        .def(py::init([](const array<double>& force,
                         const array<double>& rows,
                         const array<std::uint8_t>& holds) {
                 return likelihood_profile(flat(force), flat(rows), flat(holds));
             }),
             "force_n"_a,
             "rows"_a,
             "holds"_a)
        .def("read_one",
             &read_one,
             "row"_a,
             "offset1_deg"_a,
             "offset2_deg"_a,
             "variance1_deg2"_a,
             "variance2_deg2"_a)
        .def("read", &read_all, "rows"_a, "offset_deg"_a, "variance_deg2"_a);
}
