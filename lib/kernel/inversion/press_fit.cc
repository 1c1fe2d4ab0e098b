// SPDX-License-Identifier: GPL-3.0-or-later
#include "press_fit.h"

#include "../clones.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace gr::wiforce::kernel {

namespace {

// Steps of the fit of force and location when it ends, in nodes of the table and in mm.
constexpr double last_steps = 1e-3, last_mm = 0.02;
constexpr int most_rounds = 8;
// Of the curvature of the squared residual by that of the phases.
constexpr double most_correction = 4.0;
// deg^2, so that products over all phases are still numbers.
constexpr double least_variance = 1e-9, most_variance = 1e9;

// Force is unobservable where a phase error of 1 deg, or of the noise's size if that is
// larger, costs this much,
constexpr double unobservable_n = 0.5;
// and knowing the location would cut that by this factor.
constexpr double unobservable_ratio = 2.5;

// Errors in standard deviations, uncorrelated. The covariance D + c c' of noise D and an
// error c that all share is that of D^(1/2) (I + h h') D^(1/2) with h = D^(-1/2) c, which
// is whitened along h by 1 / sqrt(1 + h'h).
class whitening
{
public:
    whitening(const phase_reading& wanted,
              const tabulated_model::values& at,
              std::size_t phases)
        : d_phases(phases)
    {
        double square = 0;
        for (std::size_t p = 0; p < phases; p++) {
            const double variance =
                std::clamp(wanted.std[p] * wanted.std[p] + at.variance[p],
                           least_variance,
                           most_variance);
            d_determinant *= variance;
            d_scale[p] = 1 / std::sqrt(variance);
            d_along[p] = wanted.shared ? wanted.shared[p] * d_scale[p] : 0;
            square += d_along[p] * d_along[p];
        }
        d_determinant *= 1 + square;
        d_less = square > 0 ? (1 - 1 / std::sqrt(1 + square)) / square : 0;
    }

    void apply(double* values) const
    {
        double along = 0;
        for (std::size_t p = 0; p < d_phases; p++) {
            values[p] *= d_scale[p];
            along += values[p] * d_along[p];
        }
        for (std::size_t p = 0; p < d_phases; p++)
            values[p] -= d_less * along * d_along[p];
    }

    //! Of the covariance.
    double determinant() const { return d_determinant; }

private:
    std::size_t d_phases;
    double d_scale[tabulated_model::most_phases], d_along[tabulated_model::most_phases];
    double d_determinant = 1, d_less;
};

double wrap(double deg)
{
    const double turns = deg * (1.0 / 360);
    return deg - 360.0 * static_cast<double>(static_cast<std::int64_t>(
                             turns + std::copysign(0.5, turns)));
}

// Slopes are by force (N) and by location (mm).
bool hides_force(const tabulated_model::values& at,
                 std::size_t phases,
                 double force,
                 double std_deg)
{
    double by_force = 0, by_location = 0, both = 0;
    for (std::size_t p = 0; p < phases; p++) {
        const double f = at.by_log_force[p] / force, l = at.by_location[p];
        by_force += f * f;
        by_location += l * l;
        both += f * l;
    }
    const double determinant = by_force * by_location - both * both;
    const double spread = std::max(std_deg, 1.0);
    return by_location * spread * spread >
               unobservable_n * unobservable_n * determinant &&
           by_location * by_force > unobservable_ratio * unobservable_ratio * determinant;
}

} // namespace

bool press_fit::unobservable(double force, double location, double std_deg) const
{
    tabulated_model::values at;
    d_model.interpolate(d_model.steps_to(force), location, at);
    return hides_force(at, d_model.phases(), force, std_deg);
}

WIFORCE_CLONES
void press_fit::at_force(const phase_reading& wanted,
                         double reach_mm,
                         double tolerance_mm,
                         point& at) const
{
    const auto phases = d_model.phases();
    const double left = d_model.location_mm().front(),
                 right = d_model.location_mm().back();
    tabulated_model::values model;
    double error[tabulated_model::most_phases], slope[tabulated_model::most_phases];
    double move = 0, information = 0, gradient_before = 0, determinant = 1;
    for (int round = 0; round < most_rounds; round++) {
        d_model.interpolate(at.steps, at.location, model);
        double gradient = 0;
        information = 0;
        for (std::size_t p = 0; p < phases; p++) {
            error[p] = wrap(wanted.phase[p] - model.phase[p]);
            slope[p] = model.by_location[p];
        }
        const whitening white(wanted, model, phases);
        white.apply(error);
        white.apply(slope);
        determinant = white.determinant();
        for (std::size_t p = 0; p < phases; p++) {
            gradient += slope[p] * error[p];
            information += slope[p] * slope[p];
        }
        if (wanted.location)
            break;
        // Gauss-Newton, then the secant: where a large residual remains, the curvature of
        // the phases counts too.
        double curvature = information;
        if (round > 0 && move != 0)
            curvature = std::clamp((gradient_before - gradient) / move,
                                   information / most_correction,
                                   information * most_correction);
        gradient_before = gradient;
        const double step =
            std::clamp(gradient / std::max(curvature, 1e-300), -reach_mm, reach_mm);
        const double to = std::clamp(at.location + step, left, right);
        move = to - at.location;
        at.location = to;
        if (std::abs(move) < tolerance_mm)
            break;
    }
    // no more can be unknown than the line is long
    information = std::max(information, 12 / ((right - left) * (right - left)));
    double largest = 0;
    for (std::size_t p = 0; p < phases; p++) {
        at.residual[p] = error[p] - slope[p] * move;
        largest = std::max(largest, wanted.std[p]);
    }
    at.scale = 1 / std::sqrt(determinant * (wanted.location ? 1.0 : information));
    at.variance = wanted.location ? 0.0 : 1 / information;
    at.unobservable = !wanted.location && hides_force(model, phases, at.force, largest);
}

std::optional<press_fit::press>
press_fit::best(const phase_reading& wanted, double steps, double location) const
{
    const double last_step = static_cast<double>(d_model.force_n().size() - 1);
    const double left = d_model.location_mm().front(),
                 right = d_model.location_mm().back();
    tabulated_model::values at;
    for (int round = 0;; round++) {
        d_model.interpolate(steps, location, at);
        // Gauss-Newton, by nodes of force and by location
        double ff = 0, fl = 0, ll = 0, f = 0, l = 0;
        double error[tabulated_model::most_phases], by_step[tabulated_model::most_phases],
            by_location[tabulated_model::most_phases];
        for (std::size_t p = 0; p < d_model.phases(); p++) {
            error[p] = wrap(wanted.phase[p] - at.phase[p]);
            by_step[p] = at.by_log_force[p] * d_model.log_force_step();
            by_location[p] = wanted.location ? 0.0 : at.by_location[p];
        }
        const whitening white(wanted, at, d_model.phases());
        for (auto* each : { error, by_step, by_location })
            white.apply(each);
        for (std::size_t p = 0; p < d_model.phases(); p++) {
            ff += by_step[p] * by_step[p];
            fl += by_step[p] * by_location[p];
            ll += by_location[p] * by_location[p];
            f += by_step[p] * error[p];
            l += by_location[p] * error[p];
        }
        if (wanted.location)
            ll = 1;
        const double determinant = ff * ll - fl * fl;
        if (!(determinant > 0))
            return std::nullopt;
        const double move = (ll * f - fl * l) / determinant;
        const double shift = (ff * l - fl * f) / determinant;
        steps += move;
        location += shift;
        if (!(steps > 0 && steps < last_step && location >= left && location <= right))
            return std::nullopt;
        if (std::abs(move) < last_steps && std::abs(shift) < last_mm) {
            const double force =
                d_model.force_n().front() * std::exp(steps * d_model.log_force_step());
            const double per_step = force * d_model.log_force_step();
            return press{ force,
                          location,
                          ll / determinant * per_step * per_step,
                          -fl / determinant * per_step,
                          wanted.location ? 0.0 : ff / determinant };
        }
        if (round == most_rounds)
            return std::nullopt;
    }
}

} // namespace gr::wiforce::kernel
