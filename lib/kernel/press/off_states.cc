// SPDX-License-Identifier: GPL-3.0-or-later
#include "off_states.h"

#include <algorithm>
#include <cmath>

namespace gr::wiforce::kernel {

namespace {

constexpr double step = 1e-4; // of an off state, for its derivatives

} // namespace

off_states::off_states(const pair_of_ends& untouched,
                       const std::array<std::complex<double>, 2>& off,
                       double std)
    : d_std(std)
{
    for (int e = 0; e < 2; e++)
        d_end[e] = { std::polar(1.0, untouched[e]), off[e] };
}

bool off_states::differ(double contact_np) const
{
    return std::abs(d_end[0].off - d_end[1].off) > std::max(2 * contact_np, 5 * d_std);
}

// |off + q e^{j (change + arg u)}| = 1 with u = e^{j psi0} - off and q = |u| |R|.
double off_states::end::amplitude(double change) const
{
    if (off == 0.0)
        return 0;
    const auto u = untouched - off;
    const double size = std::abs(u),
                 along = (std::polar(1.0, change) * u / size * std::conj(off)).real();
    return std::log((std::sqrt(along * along + 1 - std::norm(off)) - along) / size);
}

double off_states::end::slope(double change) const
{
    const auto u = untouched - off;
    const auto projected = std::polar(1.0, change) * u / std::abs(u) * std::conj(off);
    const double along = projected.real();
    return projected.imag() / std::sqrt(along * along + 1 - std::norm(off));
}

std::complex<double> off_states::end::sensitivity(double change) const
{
    const auto is = amplitude(change);
    const end real{ untouched, off + step },
        imag{ untouched, off + std::complex<double>(0, step) };
    return { (real.amplitude(change) - is) / step, (imag.amplitude(change) - is) / step };
}

pair_of_ends off_states::amplitude(const pair_of_ends& change) const
{
    return { d_end[0].amplitude(change[0]), d_end[1].amplitude(change[1]) };
}

double off_states::slope(const pair_of_ends& change) const
{
    return d_end[0].slope(change[0]) - d_end[1].slope(change[1]);
}

double off_states::variance(const pair_of_ends& change) const
{
    if (d_std == 0)
        return 0;
    double sum = 0;
    for (int e = 0; e < 2; e++)
        sum += std::norm(d_end[e].sensitivity(change[e]));
    return d_std * d_std * sum;
}

} // namespace gr::wiforce::kernel
