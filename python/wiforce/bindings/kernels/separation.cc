// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/clocks/clock_likelihood.h>
#include <kernel/clocks/clock_tracker.h>
#include <kernel/separation/coherent_residual.h>
#include <kernel/separation/end_fit.h>
#include <kernel/separation/noise_estimate.h>
#include <kernel/separation/phase_expansion.h>

#include <pybind11/stl.h>

#include <optional>

namespace py = pybind11;
using namespace py::literals;
using namespace gr::wiforce::kernel;

namespace {

// An array that belongs to another object.
template <class T>
py::array_t<T> view(std::vector<T>& values, const shape& of, const py::object& owner)
{
    return py::array_t<T>(of, values.data(), owner);
}

// A member of an end_fit as an array over its groups.
template <class T, class Rows, class Columns>
auto member(std::vector<T> end_fit::*values, Rows rows, Columns columns)
{
    return [=](const py::object& self) {
        auto& fit = self.cast<end_fit&>();
        return view(fit.*values,
                    { py::ssize_t(fit.sizes.groups),
                      py::ssize_t(fit.sizes.*rows),
                      py::ssize_t(fit.sizes.*columns) },
                    self);
    };
}

end_fit make_end_fit(const complex_array& mixed, const complex_array& tones)
{
    if (mixed.ndim() != 3 || tones.ndim() != 3 || mixed.shape(0) != tones.shape(0) ||
        mixed.shape(1) != tones.shape(1) || mixed.shape(2) % 4)
        throw std::invalid_argument(
            "end_fit: mixed must have shape (G, M, 4S), tones (G, M, K)");
    return end_fit({ std::size_t(tones.shape(0)),
                     std::size_t(tones.shape(1)),
                     std::size_t(mixed.shape(2) / 2),
                     std::size_t(tones.shape(2)) },
                   mixed.data(),
                   tones.data());
}

py::tuple whitened(const complex_array& whitener, const complex_array& tones)
{
    if (tones.ndim() != 3)
        throw std::invalid_argument("whiten: tones must have shape (G, M, K)");
    const py::ssize_t groups = tones.shape(0), count = tones.shape(1),
                      subcarriers = tones.shape(2);
    require_shape(whitener, { count, count }, "whiten: whitener must have shape (M, M)");
    complex_array white(shape{ groups, count, subcarriers });
    array<double> level(shape{ groups });
    for (py::ssize_t group = 0; group < groups; group++)
        level.mutable_data()[group] = whiten(whitener.data(),
                                             tones.data(group, 0, 0),
                                             count,
                                             subcarriers,
                                             white.mutable_data(group, 0, 0));
    return py::make_tuple(white, level);
}

shape by_subcarrier(const end_fit::shape& sizes)
{
    return { py::ssize_t(sizes.groups), py::ssize_t(sizes.subcarriers) };
}

py::array_t<double> power_at(const phase_expansion& of, const array<double>& shifts)
{
    if (shifts.ndim() != 2 || shifts.shape(0) > py::ssize_t(of.sizes.groups) ||
        shifts.shape(1) != py::ssize_t(of.sizes.ends / 2))
        throw std::invalid_argument("phase_expansion: shifts must have shape (G, S)");
    return copy(of.power_at(shifts.data(), shifts.shape(0)),
                { shifts.shape(0), py::ssize_t(of.sizes.subcarriers) });
}

py::tuple informed(const phase_expansion& of, const array<double>& inverse_noise)
{
    require_shape(inverse_noise,
                  { py::ssize_t(of.sizes.subcarriers) },
                  "phase_expansion: inverse_noise must have shape (K,)");
    const auto found = of.informed(inverse_noise.data());
    const py::ssize_t groups = of.sizes.groups, tags = of.sizes.ends / 2;
    return py::make_tuple(copy(found.gradient, { groups, tags }),
                          copy(found.expected, { groups, tags, tags }),
                          copy(found.excess, { groups, tags }));
}

py::array_t<double> likelihood_at(const clock_likelihood& of,
                                  const array<double>& phase,
                                  const complex_array& tones,
                                  const array<double>& inverse_noise)
{
    if (phase.ndim() != 1 || tones.ndim() != 3 || inverse_noise.ndim() != 1)
        throw std::invalid_argument("clock_likelihood: phase must have shape (G,), tones "
                                    "(G, L, K), inverse_noise (K,)");
    const py::ssize_t groups = phase.size(), subcarriers = inverse_noise.size();
    require_shape(tones,
                  { groups, py::ssize_t(of.lines()), subcarriers },
                  "clock_likelihood: tones must have shape (G, L, K)");
    py::array_t<double> found(shape{ groups, 3 });
    for (py::ssize_t group = 0; group < groups; group++) {
        const auto terms = of.at(
            phase.at(group), tones.data(group, 0, 0), inverse_noise.data(), subcarriers);
        std::copy(terms.begin(), terms.end(), found.mutable_data(group, 0));
    }
    return found;
}

using clocks = std::vector<clock_tracker*>;

py::tuple predict_clocks(const clocks& trackers, const array<double>& center_s)
{
    const py::ssize_t groups = center_s.size(), tags = trackers.size();
    py::array_t<double> phase(shape{ groups, tags }), rate(shape{ groups, tags });
    for (py::ssize_t group = 0; group < groups; group++)
        for (py::ssize_t tag = 0; tag < tags; tag++) {
            const auto& clock = *trackers[tag];
            *phase.mutable_data(group, tag) = clock.predict(center_s.data()[group]);
            *rate.mutable_data(group, tag) = clock.rate;
        }
    return py::make_tuple(phase, rate);
}

py::tuple follow_by(const clocks& trackers,
                    const std::vector<double>& center_s,
                    const array<double>& assumed,
                    const array<double>& likelihood,
                    const std::optional<array<double>>& errors,
                    double noise_level,
                    const std::vector<double>& reach_rad,
                    double absent_s,
                    double unseen_s)
{
    const py::ssize_t groups = center_s.size(), tags = trackers.size();
    require_shape(
        assumed, { groups, tags }, "follow_clocks: assumed must have shape (G, S)");
    require_shape(likelihood,
                  { groups, tags, 3 },
                  "follow_clocks: likelihood must have shape (G, S, 3)");
    if (errors)
        require_shape(*errors,
                      { groups, tags, 2 },
                      "follow_clocks: errors must have shape (G, S, 2)");
    if (py::ssize_t(reach_rad.size()) != tags)
        throw std::invalid_argument("follow_clocks: reach_rad must have shape (S,)");
    const auto measured = errors ? structures<clock_tracker::measurement>(*errors)
                                 : std::vector<clock_tracker::measurement>{};
    const auto found = follow_clocks(trackers,
                                     { center_s,
                                       assumed.data(),
                                       likelihood.data(),
                                       errors ? measured.data() : nullptr,
                                       noise_level },
                                     { reach_rad, absent_s, unseen_s });
    const shape taken{ py::ssize_t(found.groups), tags };
    py::array_t<bool> received(taken);
    std::copy(found.received.begin(), found.received.end(), received.mutable_data());
    return py::make_tuple(copy(found.phase, taken), copy(found.rate, taken), received);
}

py::tuple coherent_factors(coherent_residual& of,
                           const end_fit& fit,
                           const std::vector<std::size_t>& rows,
                           const array<double>& inverse_noise)
{
    require_shape(inverse_noise,
                  by_subcarrier(fit.sizes),
                  "coherent_residual: inverse_noise must have shape (G, K)");
    if (rows.size() != fit.sizes.ends)
        throw std::invalid_argument("coherent_residual: rows must have shape (E,)");
    const auto found = of.update(fit, rows, inverse_noise.data());
    const shape by_end{ py::ssize_t(fit.sizes.groups), py::ssize_t(fit.sizes.ends) };
    py::array_t<bool> disturbed(by_end);
    std::copy(found.disturbed.begin(), found.disturbed.end(), disturbed.mutable_data());
    return py::make_tuple(copy(found.factor, by_end), disturbed);
}

py::tuple follow(noise_estimate& noise,
                 const array<double>& residuals,
                 std::size_t freedom,
                 const std::vector<double>& levels,
                 const std::vector<bool>& complete)
{
    const py::ssize_t groups = levels.size(), subcarriers = noise.variance().size();
    require_shape(residuals,
                  { groups, subcarriers },
                  "noise_estimate: residuals must have shape (G, K)");
    if (!groups || !subcarriers || complete.size() != levels.size())
        throw std::invalid_argument("noise_estimate: levels and complete must have shape "
                                    "(G,), and the noise must be known");
    const auto found = noise.follow(residuals.data(), freedom, levels, complete);
    const py::ssize_t count = found.ratio.size();
    return py::make_tuple(copy(found.ratio, { count }),
                          copy(found.raised, { count, subcarriers }),
                          copy(found.inverse, { count, subcarriers }),
                          copy(found.variance, { count, subcarriers }),
                          static_cast<int>(found.outcome));
}

py::array_t<double> raised_of(const array<double>& ratios, std::size_t freedom)
{
    if (ratios.ndim() != 2 || !ratios.shape(1))
        throw std::invalid_argument("raised_subcarriers: ratios must have shape (G, K)");
    const py::ssize_t subcarriers = ratios.shape(1);
    py::array_t<double> found(shape{ ratios.shape(0), subcarriers });
    for (py::ssize_t group = 0; group < ratios.shape(0); group++) {
        const double* const row = ratios.data(group, 0);
        const auto raised = raised_subcarriers({ row, row + subcarriers }, freedom);
        std::copy(raised.begin(), raised.end(), found.mutable_data(group, 0));
    }
    return found;
}

} // namespace

void bind_separation(py::module& m)
{
    m.def("whiten",
          &whitened,
          "whitener"_a,
          "tones"_a,
          "whitener: (M, M). tones: (G, M, K). Gives (G, M, K), and their mean power "
          "(G,).");
    using sizes = end_fit::shape;
    py::class_<end_fit>(m, "end_fit", "mixed: (G, M, 4S). tones: (G, M, K).")
        .def(py::init(&make_end_fit), "mixed"_a, "tones"_a)
        .def(
            "solve",
            [](end_fit& fit, const complex_array& tones) {
                require_shape(tones,
                              { py::ssize_t(fit.sizes.groups),
                                py::ssize_t(fit.sizes.tones),
                                py::ssize_t(fit.sizes.subcarriers) },
                              "end_fit: tones must have shape (G, M, K)");
                fit.solve(tones.data());
            },
            "tones"_a,
            "Fit other tones of the same groups at the same clocks: ends and residual.")
        .def_property_readonly("white",
                               member(&end_fit::mixing, &sizes::tones, &sizes::ends),
                               "(G, M, E), the waveforms.")
        .def_property_readonly("slopes",
                               member(&end_fit::slopes, &sizes::tones, &sizes::ends),
                               "(G, M, E), their derivatives.")
        .def_property_readonly("solver",
                               member(&end_fit::solver, &sizes::ends, &sizes::tones),
                               "(G, E, M), pseudo-inverse of white.")
        .def_property_readonly("ends",
                               member(&end_fit::ends, &sizes::ends, &sizes::subcarriers),
                               "(G, E, K).")
        .def_property_readonly(
            "residual",
            member(&end_fit::residual, &sizes::tones, &sizes::subcarriers),
            "(G, M, K); may be changed.")
        .def_property_readonly(
            "gain",
            [](const py::object& self) {
                auto& fit = self.cast<end_fit&>();
                return view(
                    fit.gain,
                    { py::ssize_t(fit.sizes.groups), py::ssize_t(fit.sizes.ends) },
                    self);
            },
            "(G, E), variance of an end over that of H.")
        .def_property_readonly("freedom",
                               &end_fit::freedom,
                               "Degrees of freedom of a group on one subcarrier.")
        .def(
            "power",
            [](const end_fit& fit) {
                return copy(fit.power(), by_subcarrier(fit.sizes));
            },
            "(G, K), sum of the squared residual over the tones.");
    py::class_<phase_expansion>(
        m,
        "phase_expansion",
        "A fit of ends, expanded to second order in the phases of the clocks.")
        .def(py::init<const end_fit&>(), "fit"_a)
        .def("power_at",
             &power_at,
             "shifts"_a,
             "shifts: (G, S), in rad, of the first groups. Gives (G, K).")
        .def(
            "set_power",
            [](phase_expansion& of, const end_fit& fit) { of.power = fit.power(); },
            "fit"_a,
            "Take the power of a residual that was changed since.")
        .def("information",
             &informed,
             "inverse_noise"_a,
             "inverse_noise: (K,). Gives gradient (G, S), expected (G, S, S), excess (G, "
             "S).");
    py::class_<clock_likelihood>(
        m, "clock_likelihood", "derivatives: (6, L). lines: (L,).")
        .def(py::init([](const complex_array& derivatives, const array<double>& lines) {
                 return clock_likelihood(flat(derivatives), flat(lines));
             }),
             "derivatives"_a,
             "lines"_a)
        .def("at",
             &likelihood_at,
             "phase"_a,
             "tones"_a,
             "inverse_noise"_a,
             "phase: (G,), rad. tones: (G, L, K). inverse_noise: (K,). Gives (G, 3).");
    py::class_<clock_tracker>(
        m, "clock_tracker", "A tag's free-running clock from group to group.")
        .def(py::init([](double time_s,
                         double phase,
                         double rate,
                         std::pair<double, double> variances,
                         double nominal_rate,
                         double subcarriers,
                         double slope_variance,
                         std::pair<double, double> energy_and_curvature,
                         std::size_t groups,
                         double seen_s) {
                 return clock_tracker({ time_s,
                                        phase,
                                        rate,
                                        variances.first,
                                        variances.second,
                                        nominal_rate,
                                        subcarriers,
                                        slope_variance,
                                        energy_and_curvature.first,
                                        energy_and_curvature.second,
                                        groups,
                                        seen_s });
             }),
             "time_s"_a,
             "phase"_a,
             "rate"_a,
             "variances"_a,
             "nominal_rate"_a,
             "subcarriers"_a,
             "slope_variance"_a,
             "energy_and_curvature"_a,
             "groups"_a,
             "seen_s"_a)
        .def(py::init<const clock_tracker&>(), "other"_a)
        .def_readonly("time_s", &clock_tracker::time_s, "Time of phase and rate.")
        .def_readonly("seen_s",
                      &clock_tracker::seen_s,
                      "Centre of the last group that held the tag.")
        .def_readwrite("phase", &clock_tracker::phase, "In rad.")
        .def_readwrite("rate", &clock_tracker::rate, "Above nominal, in rad/s.")
        .def_readwrite("variances",
                       &clock_tracker::variances,
                       "Of the phase, the covariance, and of the rate.")
        .def("predict",
             &clock_tracker::predict,
             "at_s"_a,
             "The phase expected at a time, in rad.")
        .def("ahead_of",
             &clock_tracker::ahead_of,
             "phase"_a,
             "at_s"_a,
             "By how much the phase expected at a time exceeds another one, in rad.")
        .def(
            "expired",
            [](const clock_tracker& of, double at_s, double absent_s, double unseen_s) {
                return clock_limits{ {}, absent_s, unseen_s }.expired(of, at_s);
            },
            "at_s"_a,
            "absent_s"_a,
            "unseen_s"_a,
            "Whether the tag was absent, or not received, for longer than this.");
    m.def("predict_clocks",
          &predict_clocks,
          "trackers"_a,
          "center_s"_a,
          "Phases and rates (G, S) expected at times (G,).");
    m.def("follow_clocks",
          &follow_by,
          "trackers"_a,
          "center_s"_a,
          "assumed"_a,
          "likelihood"_a,
          "errors"_a,
          "noise_level"_a,
          "reach_rad"_a,
          "absent_s"_a,
          "unseen_s"_a,
          "center_s: (G,). assumed: (G, S). likelihood: (G, S, 3). errors: (G, S, 2) or "
          "None.\n"
          "reach_rad: (S,). Gives phases, rates, and whether received, (n, S).");
    py::class_<coherent_residual>(m, "coherent_residual", "ends: of all tags.")
        .def(py::init<std::size_t>(), "ends"_a)
        .def("reset",
             &coherent_residual::reset,
             "Forget the groups so far, when the clocks were acquired again.")
        .def("update",
             &coherent_factors,
             "fit"_a,
             "rows"_a,
             "inverse_noise"_a,
             "rows: (E,). inverse_noise: (G, K). Gives factor and disturbed (G, E).");
    py::class_<noise_estimate>(m, "noise_estimate", "profile: (K,), or None.")
        .def(py::init([](double group_period_s,
                         const std::optional<array<double>>& profile) {
                 return noise_estimate(group_period_s,
                                       profile ? flat(*profile) : std::vector<double>{});
             }),
             "group_period_s"_a,
             "profile"_a = py::none())
        .def_readwrite("known",
                       &noise_estimate::known,
                       "Whether there is an estimate; until then arrays are empty.")
        .def_property_readonly(
            "variance",
            [](const noise_estimate& of) {
                return copy(of.variance(), { py::ssize_t(of.variance().size()) });
            },
            "(K,), sigma_k^2.")
        .def_property_readonly(
            "inverse",
            [](const noise_estimate& of) {
                return copy(of.inverse(), { py::ssize_t(of.inverse().size()) });
            },
            "(K,), 1 / sigma_k^2.")
        .def_property_readonly(
            "level", &noise_estimate::level, "Mean of the variance over the subcarriers.")
        .def(
            "set",
            [](noise_estimate& of,
               const array<double>& variance,
               double level,
               std::optional<std::size_t> groups) {
                if (variance.ndim() != 1 || !variance.size())
                    throw std::invalid_argument(
                        "noise_estimate: variance must have shape (K,)");
                of.set(flat(variance), level);
                if (groups)
                    of.set_groups(*groups);
            },
            "variance"_a,
            "level"_a,
            "groups"_a = py::none(),
            "variance: (K,). groups: unchanged when not given.")
        .def("follow",
             &follow,
             "residuals"_a,
             "freedom"_a,
             "levels"_a,
             "complete"_a,
             "residuals: (G, K). levels, complete: (G,). Gives ratio (n,), raised, "
             "inverse and\n"
             "variance (n, K), and the verdict: 0 learned, 1 stepped, 2 lost.");
    m.attr("OUTLIER_RATIO") = outlier_ratio;
    m.attr("STEP_GROUPS") = step_groups;
    m.def("raised_subcarriers",
          &raised_of,
          "ratios"_a,
          "freedom"_a,
          "ratios: (G, K). Gives (G, K).");
    m.def("chi_squared_limit",
          &chi_squared_limit,
          "freedom"_a,
          "stds"_a,
          "With so many complex degrees of freedom.");
}
