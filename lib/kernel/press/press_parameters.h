// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace gr::wiforce::kernel {

/*!
 * \brief What may happen to a sensor, how often and how strongly.
 *
 * docs/press.md has these as a table, and what half and twice of each do. No value
 * depends on the length of a group. The longer something has lasted the longer it lasts:
 * a change has the rate 1 / (age + settling_s).
 */
struct press_parameters {
    double period_s = 0.036; // length of a group
    double settling_s = 0.3; // s: see above
    double release = 0.4;    // shares of the changes of a press: it ends,
    double exchange = 0.1;   // becomes another one at once (the rest changes steadily),
    double unexplained =
        0.02; // or a contact that the model does not contain; of all changes
    double change_s = 0.03;   // mean time that a sudden change takes
    double steady_deg = 25.0; // by how much a steady change goes on
    double steady_s =
        0.5; // for how long a turning tag, or a hand, goes on; not a warm finger
    double turns = 3e-4; // 1/s: turns of the tag or an antenna, until they are learned
    double turns_per_s = -1.0; // stated rate of turns; negative to learn it
    double expected_s =
        10.0; // s: time that expected rates are worth, where they are learned
    double turn_deg = 15.0; // standard deviation of a sudden turn
    double turn_np =
        0.1; // and of the change of amplitude that comes with one by turn_deg
    double hands =
        3e-4; // 1/s: hands that come near, or move there, until they are learned
    double steps =
        0.003; // 1/s: steps of the receiver's phase or gain, and of the tag's level;
               // until they are learned, bursts, failing supplies and moves of a cable
    double rarest = 1e-5;     // 1/s: what happens less often is not followed
    double contact_np = 0.05; // spread of a contact's loss of amplitude
    double aside = 0.1; // rad: error of the direction in which the model moves a press
    double phase_deg = 0.03;      // error of a phase that no noise explains
    double amplitude_np = 0.003;  // likewise of an amplitude
    double fading_np = 0.01;      // Np per sqrt(s): random walk of the tag's amplitude
    double drift_memory_s = 20.0; // s: memory of the rates of drift
    double smoothing_s = 0;  // time over which groups are averaged while nothing changes
    double drift_deg = -1.0; // deg per sqrt(s): stated random walk; negative to learn it
};

} // namespace gr::wiforce::kernel
