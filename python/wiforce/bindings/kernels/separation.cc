// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels.h"

#include <kernel/separation/clock_tracker.h>
#include <kernel/separation/end_fit.h>
#include <kernel/separation/end_separation.h>
#include <kernel/separation/group_weights.h>
#include <kernel/separation/matrix_product.h>
#include <kernel/separation/noise_estimate.h>
#include <kernel/separation/spread_lines.h>

#include <memory>
#include <optional>

using namespace gr::wiforce::kernel;

namespace {

// A member of an end_fit as an array over its groups, which the fit owns.
template <class T, class... Sizes>
auto member(std::vector<T> end_fit::*values, Sizes... sizes)
{
    return [=](const py::object& self) {
        auto& fit = self.cast<end_fit&>();
        const shape of{ py::ssize_t(fit.sizes.groups), py::ssize_t(fit.sizes.*sizes)... };
        return py::array_t<T>(of, (fit.*values).data(), self);
    };
}

end_fit make_end_fit(const array<double>& mixed, const complex_array& tones)
{
    const char* const rule =
        "end_fit: mixed must have shape (G, M, 4S), tones (G, M, K), M even";
    const auto [groups, count, subcarriers] = sizes_of<3>(tones, rule);
    const py::ssize_t columns = sizes_of<3>(mixed, rule)[2];
    require_shape(mixed, { groups, count, columns }, rule);
    if (count % 2 || columns % 4)
        throw std::invalid_argument(rule);
    end_fit fit({ std::size_t(groups),
                  std::size_t(count),
                  std::size_t(columns / 2),
                  std::size_t(subcarriers) },
                mixed.data());
    fit.solve(tones.data());
    return fit;
}

py::tuple whitened(const array<double>& whitener, const complex_array& tones)
{
    const char* const rule =
        "whiten: tones must have shape (G, M, K), M even, whitener (M, M)";
    const auto [groups, count, subcarriers] = sizes_of<3>(tones, rule);
    require_shape(whitener, { count, count }, rule);
    if (count % 2)
        throw std::invalid_argument(rule);
    complex_array white(shape{ groups, count, subcarriers });
    array<double> level(shape{ groups });
    std::vector<complex> parts(count * subcarriers);
    for (py::ssize_t group = 0; group < groups; group++) {
        parts_of(tones.data(group, 0, 0), count, subcarriers, parts.data());
        std::complex<double>* const to = white.mutable_data(group, 0, 0);
        whiten(whitener.data(), parts.data(), count, subcarriers, to);
        level.mutable_data()[group] =
            power_of(to, parts.size()) / double(std::max<std::size_t>(parts.size(), 1));
    }
    return py::make_tuple(white, level);
}

group_weights make_group_weights(const array<double>& mixer,
                                 const array<double>& times_s,
                                 const array<double>& whitener,
                                 double loss)
{
    const char* const rule = "group_weights: mixer must have shape (n, M), n >= 1, M "
                             "even, times_s (n,), whitener (M, M)";
    const auto [snapshots, tones] = sizes_of<2>(mixer, rule);
    require_shape(times_s, { snapshots }, rule);
    require_shape(whitener, { tones, tones }, rule);
    if (snapshots < 1 || tones % 2)
        throw std::invalid_argument(rule);
    return { flat(mixer), flat(times_s), flat(whitener), loss };
}

array<double> mix_switching(const group_weights& weights,
                            const array<double>& clocks,
                            const array<double>& pulses)
{
    const char* const rule =
        "group_weights: clocks must have shape (G, S, 3), pulses (S, 3)";
    const auto [groups, tags, three] = sizes_of<3>(clocks, rule);
    require_shape(clocks, { groups, tags, 3 }, rule);
    require_shape(pulses, { tags, three }, rule);
    const auto at = structures<switching_clock>(clocks);
    const auto of = structures<switching_pulses>(pulses);
    const std::size_t count = weights.tones();
    array<double> mixed(shape{ groups, py::ssize_t(count), 4 * tags });
    for (py::ssize_t group = 0; group < groups; group++) {
        const auto one = weights.switched(at.data() + group * tags, of.data(), tags);
        whiten(weights.whitener().data(),
               one.data(),
               count,
               4 * tags,
               mixed.mutable_data(group, 0, 0));
    }
    return mixed;
}

std::unique_ptr<spread_lines>
make_spread_lines(const array<int>& bins,
                  const complex_array& spectrum,
                  const complex_array& factors,
                  int repetitions,
                  const std::optional<complex_array>& rotation,
                  int rounds)
{
    return std::make_unique<spread_lines>(
        spread_lines::settings{ flat(bins),
                                flat(spectrum),
                                flat(factors),
                                repetitions,
                                rotation ? flat(*rotation) : std::vector<complex>{},
                                rounds });
}

complex_array without_spread(spread_lines& of,
                             const end_fit& fit,
                             const std::vector<const group_weights*>& weights,
                             const array<double>& clocks,
                             const array<double>& pulses,
                             const complex_array& tones)
{
    const char* const rule =
        "spread_lines: weights must have shape (G,), clocks (G, S, 3), pulses (S, 3), "
        "tones (G, M, K), as the fit, and M must be that of the rotation";
    const auto& sizes = fit.sizes;
    const py::ssize_t groups = sizes.groups, count = sizes.tones, tags = sizes.ends / 2;
    require_shape(clocks, { groups, tags, 3 }, rule);
    require_shape(pulses, { tags, 3 }, rule);
    require_shape(tones, { groups, count, py::ssize_t(of.subcarriers()) }, rule);
    if (weights.size() != sizes.groups || sizes.subcarriers != of.subcarriers() ||
        (of.tones() && of.tones() != sizes.tones))
        throw std::invalid_argument(rule);
    const auto at = structures<switching_clock>(clocks);
    const auto pulses_of = structures<switching_pulses>(pulses);
    complex_array cleaned(shape{ groups, count, py::ssize_t(of.subcarriers()) });
    std::vector<complex> parts(sizes.tones * sizes.subcarriers);
    for (py::ssize_t group = 0; group < groups; group++) {
        const auto& by = *weights[group];
        if (by.tones() != sizes.tones)
            throw std::invalid_argument(rule);
        const auto* const clock = at.data() + group * tags;
        const auto switched = by.switched(clock, pulses_of.data(), tags);
        parts_of(tones.data(group, 0, 0), count, sizes.subcarriers, parts.data());
        of.remove(fit, group, by, clock, pulses_of.data(), switched.data(), parts.data());
        whiten(by.whitener().data(),
               parts.data(),
               count,
               sizes.subcarriers,
               cleaned.mutable_data(group, 0, 0));
    }
    return cleaned;
}

py::dict separate(end_separation& of,
                  const std::vector<end_separation::tag>& tags,
                  const std::vector<const group_weights*>& weights,
                  const array<double>& center_s,
                  const std::vector<bool>& complete,
                  const py::array& tones,
                  noise_estimate& noise,
                  bool update,
                  spread_lines* spread,
                  const std::optional<py::function>& wander)
{
    const py::ssize_t count = weights.size();
    const py::ssize_t subcarriers = noise.variance().size();
    const py::ssize_t rows = count ? weights[0]->tones() : 0;
    require_shape(
        center_s, { count }, "end_separation: weights and center_s must have shape (G,)");
    if (complete.size() != weights.size())
        throw std::invalid_argument("end_separation: complete must have shape (G,)");
    std::vector<end_separation::group> groups;
    py::array kept; // what the groups point to
    const auto add = [&](const auto& values) {
        require_shape(values,
                      { count, rows, subcarriers },
                      "end_separation: tones must have shape (G, M, K)");
        for (py::ssize_t group = 0; group < count; group++) {
            if (py::ssize_t(weights[group]->tones()) != rows)
                throw std::invalid_argument("end_separation: weights must have M tones");
            groups.push_back({ weights[group],
                               center_s.at(group),
                               complete[group],
                               values.data(group, 0, 0) });
        }
        kept = values;
    };
    // Single precision is read as it is, since batches of many tones exceed the caches.
    using single_array = array<std::complex<float>>;
    if (tones.dtype().equal(py::dtype::of<std::complex<float>>()))
        add(single_array(tones));
    else
        add(complex_array(tones));
    for (const auto& tag : tags) {
        if (tag.index >= of.tags())
            throw std::invalid_argument("end_separation: index must be that of a tag");
        for (const std::size_t line : tag.lines)
            if (py::ssize_t(line) >= rows)
                throw std::invalid_argument("end_separation: lines must be tones");
    }
    using values = std::vector<double>;
    end_separation::remove_wander by;
    if (wander)
        by = [&](std::size_t row, end_fit& fit, const values& phase, const values& rate) {
            py::gil_scoped_acquire python;
            const shape by_tag{ py::ssize_t(phase.size()) };
            (*wander)(row,
                      py::cast(&fit, py::return_value_policy::reference),
                      copy(phase, by_tag),
                      copy(rate, by_tag));
        };
    if (spread && (py::ssize_t(spread->subcarriers()) != subcarriers ||
                   (spread->tones() && py::ssize_t(spread->tones()) != rows && count)))
        throw std::invalid_argument("end_separation: spread must be of these tones");
    const auto found = [&] {
        py::gil_scoped_release others_may_run;
        return of.process(tags, groups, subcarriers, noise, update, spread, by);
    }();
    const py::ssize_t taken = found.groups, all = of.tags();
    const shape by_tag{ taken, all }, by_end{ taken, 2 * all },
        by_subcarrier{ taken, subcarriers };
    const auto flags = [&](const std::vector<char>& of) {
        py::array_t<bool> set(by_tag);
        std::copy(of.begin(), of.end(), set.mutable_data());
        return set;
    };
    return py::dict("ends"_a = copy(found.ends, { taken, 2 * all, subcarriers }),
                    "gain"_a = copy(found.gain, by_end),
                    "snr_db"_a = copy(found.snr_db, by_end),
                    "noise"_a = copy(found.noise, by_subcarrier),
                    "noise_rise"_a = copy(found.noise_rise, by_subcarrier),
                    "raised"_a = copy(found.raised, { taken }),
                    "locked"_a = flags(found.locked),
                    "overlapping"_a = flags(found.overlapping),
                    "disturbed"_a = flags(found.disturbed),
                    "clock_phase"_a = copy(found.clock_phase, by_tag),
                    "clock_offset_ppm"_a = copy(found.clock_offset_ppm, by_tag),
                    "clock2_delay"_a = copy(found.clock2_delay, by_tag),
                    "lost"_a = found.outcome == noise_estimate::verdict::lost);
}

py::tuple informed(const end_fit& fit, const array<double>& inverse_noise)
{
    require_shape(inverse_noise,
                  { py::ssize_t(fit.sizes.subcarriers) },
                  "phase_information: inverse_noise must have shape (K,)");
    const auto found = information_of(fit, inverse_noise.data());
    const py::ssize_t groups = fit.sizes.groups, tags = fit.sizes.ends / 2;
    return py::make_tuple(copy(found.gradient, { groups, tags }),
                          copy(found.expected, { groups, tags, tags }),
                          copy(found.excess, { groups, tags }));
}

py::tuple errors_of(const array<double>& gradient,
                    const array<double>& information,
                    const array<double>& excess)
{
    const py::ssize_t count = gradient.size();
    const char* const rule = "phase_errors: gradient and excess must have shape (S,), "
                             "information (S, S)";
    require_shape(gradient, { count }, rule);
    require_shape(information, { count, count }, rule);
    require_shape(excess, { count }, rule);
    py::array_t<double> errors(count), variances(count);
    const auto found = phase_errors({ flat(gradient), flat(information), flat(excess) });
    for (py::ssize_t i = 0; i < count; i++) {
        errors.mutable_at(i) = found[i].error;
        variances.mutable_at(i) = found[i].variance;
    }
    return py::make_tuple(errors, variances);
}

py::array_t<double> raised_of(const array<double>& ratios, std::size_t freedom)
{
    const char* const rule = "raised_subcarriers: ratios must have shape (G, K), K >= 1";
    const auto [groups, subcarriers] = sizes_of<2>(ratios, rule);
    if (subcarriers < 1)
        throw std::invalid_argument(rule);
    py::array_t<double> found(shape{ groups, subcarriers });
    for (py::ssize_t group = 0; group < groups; group++) {
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
          R"(whitener: (M, M). tones: (G, M, K). Gives their parts with white noise (G, M,
K), and their mean power (G,).)");
    using sizes = end_fit::shape;
    py::class_<end_fit>(m, "end_fit", "mixed: (G, M, 4S). tones: (G, M, K).")
        .def(py::init(&make_end_fit))
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
            "Fit other tones of the same groups at the same clocks: ends and residual.")
        .def_property_readonly("white",
                               member(&end_fit::mixing, &sizes::tones, &sizes::ends),
                               "(G, M, E), the waveforms.")
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
        .def_property_readonly("gain",
                               member(&end_fit::gain, &sizes::ends),
                               "(G, E), variance of an end over that of H.")
        .def_property_readonly("freedom", &end_fit::freedom)
        .def(
            "power",
            [](const end_fit& fit) {
                return copy(fit.power(),
                            { py::ssize_t(fit.sizes.groups),
                              py::ssize_t(fit.sizes.subcarriers) });
            },
            "(G, K), sum of the squared residual over the tones.");
    m.def("phase_information",
          &informed,
          "Information of a fit on the phases of the clocks. inverse_noise: (K,). Gives "
          "gradient (G, S),\nexpected (G, S, S), excess (G, S).");
    m.def(
        "phase_errors",
        &errors_of,
        R"(Gauss-Newton step (S,) to be added to each phase in rad, and its variance (S,);
infinite where a phase is not determined. gradient, excess: (S,), information: (S, S).)");
    py::class_<clock_likelihood>(
        m, "clock_likelihood", "derivatives: (6, L). lines: (L,).")
        .def(py::init([](const complex_array& derivatives, const array<double>& lines) {
            return clock_likelihood(flat(derivatives), flat(lines));
        }));
    py::class_<group_weights>(
        m,
        "group_weights",
        R"(mixer: (n, M), of parts. times_s: (n,). whitener: (M, M), lower
triangular, of the parts of tones. loss: snapshots of a group over n.)")
        .def(py::init(&make_group_weights),
             "mixer"_a,
             "times_s"_a,
             "whitener"_a,
             "loss"_a = 1.0)
        .def_readonly("loss", &group_weights::loss)
        .def(
            "switched",
            &mix_switching,
            R"(Whitened parts of the tags' switching waveforms, and their derivatives: (G,
M, 4S). clocks: (G, S, 3), phase in rad and rate in rad/s at the centres, and half the
phase that a snapshot averages over. pulses: (S, 3), delay of clock 2 in rad of clock 1,
and both duty cycles.)");
    py::class_<clock_tracker>(
        m, "clock_tracker", "A tag's free-running clock from group to group.")
        .def(py::init<>())
        .def(py::init<const clock_tracker&>())
        .def_readwrite("time_s", &clock_tracker::time_s)
        .def_readwrite("phase", &clock_tracker::phase)
        .def_readwrite("rate", &clock_tracker::rate)
        .def_readwrite("variances", &clock_tracker::variances)
        .def_readwrite("nominal_rate", &clock_tracker::nominal_rate)
        .def_readwrite("subcarriers", &clock_tracker::subcarriers)
        .def_readwrite("slope_variance", &clock_tracker::slope_variance)
        .def_readwrite("energy", &clock_tracker::energy)
        .def_readwrite("curvature", &clock_tracker::curvature)
        .def_readwrite("groups", &clock_tracker::groups)
        .def_readwrite("seen_s", &clock_tracker::seen_s)
        .def("predict", py::vectorize(&clock_tracker::predict), "Times (G,), or one.")
        .def("expired", &clock_tracker::expired);
    py::class_<noise_estimate>(m, "noise_estimate", "profile: (K,), or None.")
        .def(py::init([](double group_period_s,
                         const std::optional<array<double>>& profile) {
                 return noise_estimate(group_period_s,
                                       profile ? flat(*profile) : std::vector<double>{});
             }),
             "group_period_s"_a,
             "profile"_a = py::none())
        .def_readwrite("known", &noise_estimate::known)
        .def_property_readonly(
            "variance",
            [](const noise_estimate& of) { return copy(of.variance()); },
            "(K,), sigma_k^2.")
        .def_property_readonly(
            "inverse",
            [](const noise_estimate& of) { return copy(of.inverse()); },
            "(K,), 1 / sigma_k^2.")
        .def_property_readonly("level", &noise_estimate::level)
        .def(
            "set",
            [](noise_estimate& of,
               const array<double>& variance,
               double level,
               std::optional<std::size_t> groups) {
                if (variance.ndim() != 1 || !variance.size())
                    throw std::invalid_argument(
                        "noise_estimate: variance must have shape (K,)");
                of.set(flat(variance), level, groups);
            },
            "variance"_a,
            "level"_a,
            "groups"_a = py::none(),
            "variance: (K,). groups: unchanged when not given.");
    py::class_<spread_lines>(
        m,
        "spread_lines",
        R"(Removes what tags spread over the subcarriers. bins, factors: (K,). spectrum: (N,), of
the symbol. rotation: (M/2, N), of the tones of positive frequency.)")
        .def(py::init(&make_spread_lines),
             "bins"_a,
             "spectrum"_a,
             "factors"_a,
             "repetitions"_a,
             "rotation"_a,
             "rounds"_a)
        .def("removed",
             &without_spread,
             "fit"_a,
             "weights"_a,
             "clocks"_a,
             "pulses"_a,
             "tones"_a,
             "Whitened parts of tones (G, M, K) of a fit, without what its tags spread. "
             "clocks, pulses:\nas of group_weights.switched.");
    py::class_<end_separation::tag>(
        m, "locked_tag", "A tag whose clock is tracked; rates in rad/s.")
        .def(py::init([](std::size_t index,
                         clock_tracker& clock,
                         const clock_likelihood& likelihood,
                         std::vector<std::size_t> lines,
                         double nominal_rate,
                         double stated_rate,
                         double delay,
                         std::array<double, 2> duty,
                         bool overlapping) {
                 if (lines.size() != likelihood.lines())
                     throw std::invalid_argument(
                         "locked_tag: lines must be those of the likelihood");
                 return end_separation::tag{ index,           &clock,
                                             &likelihood,     std::move(lines),
                                             nominal_rate,    stated_rate,
                                             { delay, duty }, overlapping };
             }),
             py::keep_alive<1, 3>(),
             py::keep_alive<1, 4>());
    py::class_<end_separation>(
        m, "end_separation", "Ends, clocks and noise of one group after the other.")
        .def(py::init([](std::size_t tags,
                         std::size_t group_length,
                         double averaging_s,
                         bool jointly,
                         double line_power,
                         double least_error,
                         double absent_s,
                         double unseen_s) {
            return end_separation({ tags,
                                    group_length,
                                    averaging_s,
                                    jointly,
                                    line_power,
                                    least_error,
                                    absent_s,
                                    unseen_s });
        }))
        .def("reset", &end_separation::reset)
        .def("process",
             &separate,
             "tags"_a,
             "weights"_a,
             "center_s"_a,
             "complete"_a,
             "tones"_a,
             "noise"_a,
             "update"_a,
             "spread"_a = py::none(),
             "wander"_a = py::none(),
             R"(weights, center_s, complete: (G,). tones: (G, M, K). wander is called
with the group's row, the fit, and phases and rates (S,) of the clocks. Gives arrays
of the first groups, and whether the last one shows that the model is lost.)");
    m.attr("OUTLIER_RATIO") = outlier_ratio;
    m.attr("STEP_GROUPS") = step_groups;
    m.def("raised_subcarriers", &raised_of, "ratios: (G, K). Gives (G, K).");
    m.def("chi_squared_limit",
          &chi_squared_limit,
          "With so many complex degrees of freedom.");
}
