// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstddef>
#include <deque>
#include <optional>
#include <vector>

namespace gr::wiforce::kernel {

// Ratio of a group's residual to the noise above which the group is an outlier; its
// value and those of the constants in noise_estimate.cc are measured in
// docs/data/thresholds.csv.
constexpr double outlier_ratio = 3.0;
// The noise has changed when the median over this many groups has. A press that changes
// disturbs fewer groups.
constexpr std::size_t step_groups = 8;

// Value that a mean of squares, whose expectation is 1, with so many complex degrees of
// freedom exceeds as seldom as a normal variable exceeds so many standard deviations: the
// approximation by E. B. Wilson and M. M. Hilferty (1931).
double chi_squared_limit(double freedom, double stds);

// Ratios of a group's noise to the usual one, with so many complex degrees of freedom
// each, where they are significantly more, as by a narrow-band transmitter; 1 elsewhere,
// and everywhere if the lower quartile of the ratios is raised as well.
std::vector<double> raised_subcarriers(const std::vector<double>& ratios,
                                       std::size_t freedom);

// Variance of the noise in H per subcarrier: a mean over the last two seconds of groups,
// learned from the residual of their fits.
class noise_estimate
{
public:
    enum class verdict {
        learned, // the group fits, or is a single outlier
        stepped, // the noise has risen or fallen
        lost     // `step_groups` groups in a row do not fit: noise has risen, or a clock
                 // is tracked at a wrong phase
    };

    // Noise in a group.
    struct group {
        double ratio; // residual over the noise before, 1 when the model fits; raised
                      // subcarriers count by their own
        std::vector<double> raised;  // K: noise over that of the groups before
        std::vector<double> inverse; // K: 1 / sigma_k^2 by the groups before and `raised`
        verdict outcome;
    };

    // `profile`: noise of the subcarriers relative to each other, where only its level is
    // to be learned (of what tags spread over the subcarriers within a long symbol a rest
    // has a pattern that would correlate with the weights); empty otherwise.
    noise_estimate(double group_period_s, std::vector<double> profile);

    bool known = false; // until then the arrays are empty

    const std::vector<double>& variance() const { return d_variance; } // sigma_k^2
    const std::vector<double>& inverse() const { return d_inverse; }   // 1 / sigma_k^2

    // Mean of the variance over the subcarriers.
    double level() const;

    // Sets the variance, limited to the rounding errors of the tones. `level`: mean power
    // of the whitened tones, the largest of the groups that it was measured in. `groups`:
    // number of them, unchanged when not given.
    void set(std::vector<double> variance,
             double level,
             std::optional<std::size_t> groups = std::nullopt);

    // Learns from a group, unless it is not `complete`. `residual`: mean square of its
    // whitened residual per degree of freedom, K; `level`: mean power of its whitened
    // tones.
    group follow(std::vector<double> residual,
                 std::size_t freedom,
                 double level,
                 bool complete);

private:
    verdict learn(std::vector<double> residual, const group& of, double level);

    const std::vector<double> d_profile;
    const std::size_t d_memory; // groups of the mean, at most
    std::vector<double> d_variance, d_inverse;
    std::size_t d_groups = 0;
    std::deque<double> d_ratios;
    std::vector<int> d_raised_groups; // in a row, by subcarrier
};

} // namespace gr::wiforce::kernel
