// SPDX-License-Identifier: GPL-3.0-or-later
#include "fourier_transform.h"

#include <fftw3.h>

#include <map>
#include <mutex>

namespace gr::wiforce::kernel {

namespace {

fc32* allocate(int length)
{
    return reinterpret_cast<fc32*>(fftwf_alloc_complex(length));
}

// One plan of a length serves all buffers, which FFTW aligns alike, until the process
// ends. FFTW's planner belongs to the whole process, where GNU Radio plans as well.
fftwf_plan plan_of(int length, fc32* input, fc32* output)
{
    static std::mutex one_at_a_time;
    static auto& plans = *new std::map<int, fftwf_plan>;
    const std::lock_guard lock(one_at_a_time);
    if (plans.empty()) {
        fftwf_init_threads();
        fftwf_make_planner_thread_safe();
    }
    auto& plan = plans[length];
    if (!plan) {
        fftwf_plan_with_nthreads(1);
        plan = fftwf_plan_dft_1d(length,
                                 reinterpret_cast<fftwf_complex*>(input),
                                 reinterpret_cast<fftwf_complex*>(output),
                                 FFTW_FORWARD,
                                 FFTW_ESTIMATE);
    }
    return plan;
}

} // namespace

struct fourier_transform::plan {
    explicit plan(int length)
        : input(allocate(length)),
          output(allocate(length)),
          transform(plan_of(length, input, output))
    {
    }

    ~plan()
    {
        fftwf_free(input);
        fftwf_free(output);
    }

    plan(const plan&) = delete;
    plan& operator=(const plan&) = delete;

    fc32* const input;
    fc32* const output;
    const fftwf_plan transform;
};

fourier_transform::fourier_transform(int length)
    : d_length(length), d_plan(std::make_unique<plan>(length))
{
}

fourier_transform::~fourier_transform() = default;

fc32* fourier_transform::input() { return d_plan->input; }

const fc32* fourier_transform::execute()
{
    fftwf_execute_dft(d_plan->transform,
                      reinterpret_cast<fftwf_complex*>(d_plan->input),
                      reinterpret_cast<fftwf_complex*>(d_plan->output));
    return d_plan->output;
}

} // namespace gr::wiforce::kernel
