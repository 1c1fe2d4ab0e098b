// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/phases/conjugate_difference.h>
#include <kernel/phases/receiver_steps.h>

#include <optional>

using namespace gr::wiforce::kernel;

namespace {

void set_reference(profile_check& check,
                   const complex_array& reference,
                   const complex_array& image,
                   const complex_array& other)
{
    const py::ssize_t ends = check.ends(), subcarriers = check.subcarriers();
    const char* const rule = "profile_check: reference and image must have shape (E, K), "
                             "other (E, D, K), D >= 1";
    const py::ssize_t others = sizes_of<3>(other, rule)[1];
    require_shape(reference, { ends, subcarriers }, rule);
    require_shape(image, { ends, subcarriers }, rule);
    require_shape(other, { ends, others, subcarriers }, rule);
    if (others < 1)
        throw std::invalid_argument(rule);
    check.set_reference(flat(reference), flat(image), flat(other));
}

py::dict difference_of(const complex_array& ends,
                       const array<double>& gain,
                       const array<double>& noise,
                       const std::optional<array<double>>& noise_rise,
                       const complex_array& reference,
                       const array<double>& reference_gain,
                       profile_check* check)
{
    const char* const rule =
        "conjugate_difference: ends must have shape (G, E, K), gain (G, E), noise and "
        "noise_rise (G, K), reference (E, K), reference_gain (E,)";
    const auto [groups, count, subcarriers] = sizes_of<3>(ends, rule);
    const shape by_end{ groups, count }, by_subcarrier{ groups, subcarriers };
    require_shape(gain, by_end, rule);
    require_shape(noise, by_subcarrier, rule);
    if (noise_rise)
        require_shape(*noise_rise, by_subcarrier, rule);
    require_shape(reference, { count, subcarriers }, rule);
    require_shape(reference_gain, { count }, rule);
    if (check && (check->ends() != std::size_t(count) ||
                  check->subcarriers() != std::size_t(subcarriers)))
        throw std::invalid_argument("check must be of E ends and K subcarriers");
    complex_array changes(shape{ groups, count, subcarriers });
    std::copy_n(ends.data(), ends.size(), changes.mutable_data());
    array<double> gains(by_end), power(by_end), by_reference(by_end);
    array<bool> reshaped(by_end);
    for (py::ssize_t group = 0; group < groups; group++) {
        conjugate_difference({ changes.mutable_data(group, 0, 0),
                               gain.data(group, 0),
                               noise.data(group, 0),
                               noise_rise ? noise_rise->data(group, 0) : nullptr },
                             { reference.data(), reference_gain.data() },
                             count,
                             subcarriers,
                             check,
                             { gains.mutable_data(group, 0),
                               power.mutable_data(group, 0),
                               reshaped.mutable_data(group, 0) });
        std::copy_n(reference_gain.data(), count, by_reference.mutable_data(group, 0));
    }
    return py::dict("changes"_a = changes,
                    "gain"_a = gains,
                    "reference_power"_a = power,
                    "reference_gain"_a = by_reference,
                    "reshaped"_a = reshaped);
}

array<double> steps_of(receiver_steps& steps,
                       const std::optional<complex_array>& static_path,
                       const complex_array& ratios,
                       const array<double>& reference_power,
                       const array<bool>& locked)
{
    const char* const rule = "receiver_steps: static must have shape (G, K), ratios and "
                             "reference_power (G, E), locked (G, E / 2)";
    const auto [groups, ends] = sizes_of<2>(ratios, rule);
    const py::ssize_t subcarriers = static_path ? sizes_of<2>(*static_path, rule)[1] : 0;
    if (static_path) { // without it nothing else counts
        require_shape(*static_path, { groups, subcarriers }, rule);
        require_shape(reference_power, { groups, ends }, rule);
        require_shape(locked, { groups, ends / 2 }, rule);
    }
    array<double> changes(shape{ groups, 3 });
    for (py::ssize_t group = 0; group < groups; group++) {
        const auto found = static_path ? steps.next({ static_path->data(group, 0),
                                                      ratios.data(group, 0),
                                                      reference_power.data(group, 0),
                                                      locked.data(group, 0),
                                                      std::size_t(subcarriers),
                                                      std::size_t(ends) })
                                       : receiver_steps::none();
        std::copy_n(&found.turn, 3, changes.mutable_data(group, 0));
    }
    return changes;
}

} // namespace

void bind_phases(py::module& m)
{
    py::class_<profile_check>(m, "profile_check", "Of E ends on K subcarriers.")
        .def(py::init<std::size_t, std::size_t>())
        .def("reset", &profile_check::reset, "Forget the groups so far.")
        .def("set_reference",
             &set_reference,
             "reference, image: (E, K). other: (E, D, K).");
    m.def("conjugate_difference",
          &difference_of,
          R"(ends: (G, E, K). gain: (G, E). noise: (G, K). noise_rise: (G, K) or None.
reference: (E, K). reference_gain: (E,). check: with this reference, or None. Gives
changes (G, E, K), and gain, reference_power, reference_gain and reshaped (G, E).)");
    py::class_<receiver_steps>(
        m,
        "receiver_steps",
        "Steps of the receiver's phase and gain, as the static path shows them.")
        .def(py::init<double>())
        .def("process",
             &steps_of,
             R"(static: (G, K) or None. ratios, reference_power: (G, E). locked: (G, E /
2). Gives turn, gain and variance, (G, 3).)");
}
