// SPDX-License-Identifier: GPL-3.0-or-later
#include "mapped_read.h"

#include <csetjmp>
#include <csignal>
#include <mutex>

namespace gr::wiforce::kernel {

namespace {

thread_local sigjmp_buf way_out;
thread_local volatile std::sig_atomic_t reading = 0;
thread_local bool unblocked = false;
struct sigaction before;

void on_bus_error(int number, siginfo_t* info, void* context)
{
    if (reading) {
        reading = 0;
        siglongjmp(way_out, 1);
    }
    if (before.sa_flags & SA_SIGINFO)
        before.sa_sigaction(number, info, context);
    else if (before.sa_handler != SIG_DFL && before.sa_handler != SIG_IGN)
        before.sa_handler(number);
    else
        // The read that failed is tried again, and ends the process.
        sigaction(number, &before, nullptr);
}

// GNU Radio's threads block most signals, and a blocked SIGBUS ends the process.
void unblock()
{
    sigset_t bus;
    sigemptyset(&bus);
    sigaddset(&bus, SIGBUS);
    pthread_sigmask(SIG_UNBLOCK, &bus, nullptr);
    unblocked = true;
}

} // namespace

void mapped_read::prepare()
{
    static std::mutex mutex;
    const std::lock_guard<std::mutex> guard(mutex);
    struct sigaction now;
    sigaction(SIGBUS, nullptr, &now);
    if ((now.sa_flags & SA_SIGINFO) && now.sa_sigaction == on_bus_error)
        return;
    before = now;
    struct sigaction own = {};
    own.sa_sigaction = on_bus_error;
    sigemptyset(&own.sa_mask);
    own.sa_flags = SA_SIGINFO | SA_NODEFER | SA_ONSTACK;
    sigaction(SIGBUS, &own, nullptr);
}

bool mapped_read::attempt(void (*call)(const void*), const void* read)
{
    if (!unblocked)
        unblock();
    if (sigsetjmp(way_out, 0) != 0)
        return false;
    reading = 1;
    call(read);
    reading = 0;
    return true;
}

} // namespace gr::wiforce::kernel
