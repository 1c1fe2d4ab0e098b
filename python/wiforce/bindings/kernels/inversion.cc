// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/inversion/press_posterior.h>

#include <array>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <vector>

using namespace gr::wiforce::kernel;

// Values (n, 6), force, location and their covariance, and sums of flags (n,) of n
// readings.
static py::tuple invert(const press_posterior& posterior,
                        const array<double>& phases_deg,
                        const array<double>& std_deg,
                        const std::optional<array<double>>& location_mm)
{
    const auto phases = static_cast<py::ssize_t>(posterior.phases());
    const auto count = phases_deg.ndim() == 2 ? phases_deg.shape(0) : 0;
    if (phases_deg.size() != count * phases || std_deg.size() != phases_deg.size() ||
        (location_mm && location_mm->size() != count))
        throw std::invalid_argument("phases, std and location must be of n readings");
    py::array_t<double> values({ count, py::ssize_t{ 6 } });
    py::array_t<std::uint8_t> flags(count);
    const double* const psi = phases_deg.data();
    const double* const std = std_deg.data();
    const double* const location = location_mm ? location_mm->data() : nullptr;
    double* out = values.mutable_data();
    std::uint8_t* const out_flags = flags.mutable_data();
    {
        py::gil_scoped_release others_may_run;
        press_posterior::workspace work;
        press_fit::press found;
        for (py::ssize_t i = 0; i < count; i++, out += 6) {
            out_flags[i] = posterior.invert(
                { psi + i * phases, std + i * phases, location ? location + i : nullptr },
                work,
                found);
            out[0] = found.force, out[1] = found.location;
            out[2] = found.force_variance, out[5] = found.location_variance;
            out[3] = out[4] = found.covariance;
        }
    }
    return py::make_tuple(values, flags);
}

// Phases, their slopes by force and by location, and their variances (n, 4, phases) of n
// presses within the table.
static py::array_t<double> model_at(const press_posterior& posterior,
                                    const array<double>& force,
                                    const array<double>& location)
{
    const auto& model = posterior.profile().fit().model();
    const auto phases = static_cast<py::ssize_t>(model.phases());
    if (force.ndim() != 1 || location.size() != force.size())
        throw std::invalid_argument("force and location must be of n presses");
    py::array_t<double> found({ force.size(), py::ssize_t{ 4 }, phases });
    auto out = found.mutable_unchecked<3>();
    tabulated_model::values at{};
    for (py::ssize_t i = 0; i < force.size(); i++) {
        model.interpolate(model.steps_to(force.data()[i]), location.data()[i], at);
        for (py::ssize_t p = 0; p < phases; p++) {
            out(i, 0, p) = at.phase[p];
            out(i, 1, p) = at.by_log_force[p] / force.data()[i];
            out(i, 2, p) = at.by_location[p];
            out(i, 3, p) = at.variance[p];
        }
    }
    return found;
}

void bind_inversion(py::module& m)
{
    py::dict flags;
    flags["ambiguous"] = int{ ambiguous };
    flags["force-unobservable"] = int{ force_unobservable };
    flags["inconsistent"] = int{ inconsistent };
    flags["extrapolated"] = int{ extrapolated };
    m.attr("INVERSION_FLAGS") = flags;

    py::class_<press_posterior>(
        m,
        "press_posterior",
        "Force and location given the phases; see sensor/inversion.py.")
        .def(py::init([](const array<double>& force,
                         const array<double>& location,
                         const array<double>& table,
                         const std::array<std::vector<double>, 3>& calibrated,
                         double consistent) {
            return press_posterior(
                tabulated_model(flat(force), flat(location), flat(table)),
                calibrated_span(calibrated[0], calibrated[1], calibrated[2]),
                consistent);
        }))
        .def("invert", &invert, "phases_deg"_a, "std_deg"_a, "location_mm"_a = py::none())
        .def("model_at", &model_at, "force_n"_a, "location_mm"_a)
        .def("unobservable",
             py::vectorize([](const press_posterior* posterior,
                              double force,
                              double location,
                              double std) {
                 return posterior->profile().fit().unobservable(force, location, std);
             }))
        .def("extrapolated",
             [](const press_posterior& posterior,
                double force,
                double location,
                double force_variance,
                double location_variance) {
                 return posterior.span().extrapolated(
                     force, location, force_variance, location_variance);
             });
}
