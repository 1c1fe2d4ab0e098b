// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/recording/recorded_frames.h"

#include <boost/test/unit_test.hpp>

#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csetjmp>
#include <csignal>
#include <cstdio>
#include <stdexcept>
#include <string>
#include <vector>

using gr::wiforce::kernel::mapped_part;

namespace {

constexpr std::uint64_t BYTES = 200'000;
const std::uint64_t PAGE = sysconf(_SC_PAGESIZE);

// A file whose bytes count up, 1 to 251.
struct counted_file {
    counted_file()
    {
        std::vector<char> bytes(BYTES);
        for (std::uint64_t n = 0; n < BYTES; n++)
            bytes[n] = byte(n);
        BOOST_REQUIRE(write(number, bytes.data(), BYTES) == ssize_t(BYTES));
    }
    ~counted_file() { std::fclose(file); }
    static char byte(std::uint64_t place) { return place % 251 + 1; }

    std::FILE* const file = std::tmpfile();
    const int number = fileno(file);
};

// The program's handler of the signal, for a while.
struct handling {
    explicit handling(void (*handler)(int))
    {
        struct sigaction now = {};
        now.sa_handler = handler;
        sigaction(SIGBUS, &now, &before);
    }
    ~handling() { sigaction(SIGBUS, &before, nullptr); }
    struct sigaction before;
};

sigjmp_buf back;

struct sigaction chained;

void chain(int signal, siginfo_t* info, void* context)
{
    chained.sa_sigaction(signal, info, context);
}

void look_at_missing_page_of_chained_handlers()
{
    std::signal(SIGBUS, SIG_DFL);
    const counted_file file;
    const auto look = [&] {
        mapped_part(file.number, "x").look(0, 1, [](const char*) {});
    };
    look();
    struct sigaction later = {};
    later.sa_sigaction = chain;
    later.sa_flags = SA_SIGINFO;
    sigaction(SIGBUS, &later, &chained);
    look();
    void* const other = mmap(nullptr, PAGE, PROT_READ, MAP_SHARED, file.number, 0);
    if (ftruncate(file.number, 0) == 0)
        static_cast<void>(*static_cast<volatile char*>(other));
}

// What ends a child process that runs this.
template <class Run>
int signal_that_ends(const Run& run)
{
    const pid_t child = fork();
    if (child == 0) {
        alarm(10); // ends what would go on for ever
        run();
        _exit(0);
    }
    int status = 0;
    BOOST_REQUIRE(waitpid(child, &status, 0) == child);
    return WIFSIGNALED(status) ? WTERMSIG(status) : 0;
}

} // namespace

BOOST_AUTO_TEST_CASE(a_part_holds_the_bytes_from_any_place_on)
{
    const counted_file file;
    mapped_part part(file.number, "x");
    for (const std::uint64_t first :
         { std::uint64_t(0), std::uint64_t(7), 3 * PAGE + 12 }) {
        const std::uint64_t count = BYTES - first;
        const auto unreadable = part.look(first, count, [&](const char* bytes) {
            BOOST_TEST(reinterpret_cast<std::uintptr_t>(bytes) % 4 == 0u);
            std::uint64_t n = 0;
            while (n < count && bytes[n] == counted_file::byte(first + n))
                n++;
            BOOST_TEST(n == count);
        });
        BOOST_TEST(unreadable > BYTES);
    }
}

BOOST_AUTO_TEST_CASE(a_part_that_is_cut_off_while_it_is_looked_at_holds_zeros)
{
    constexpr std::uint64_t LEFT = 100'000;
    const counted_file file;
    mapped_part part(file.number, "x");
    const auto unreadable = part.look(0, BYTES, [&](const char* bytes) {
        BOOST_TEST(bytes[BYTES - 1] == counted_file::byte(BYTES - 1));
        BOOST_REQUIRE(ftruncate(file.number, LEFT) == 0);
        const auto is_zero = [](char byte) { return byte == 0; };
        BOOST_TEST(std::all_of(bytes + LEFT, bytes + BYTES, is_zero));
        BOOST_TEST(bytes[LEFT - 1] == counted_file::byte(LEFT - 1));
    });
    BOOST_TEST(unreadable == (LEFT / PAGE + 1) * PAGE);
}

BOOST_AUTO_TEST_CASE(a_missing_page_of_somebody_else_is_handled_by_the_program)
{
    const handling now([](int) { siglongjmp(back, 1); });
    const counted_file file;
    mapped_part part(file.number, "x");
    void* const other = mmap(nullptr, PAGE, PROT_READ, MAP_SHARED, file.number, 0);
    bool handled = false;
    part.look(0, 1, [&](const char*) {
        BOOST_REQUIRE(ftruncate(file.number, 0) == 0);
        if (sigsetjmp(back, 1) == 0)
            static_cast<void>(*static_cast<volatile char*>(other));
        else
            handled = true;
    });
    BOOST_TEST(handled);
    munmap(other, PAGE);
}

BOOST_AUTO_TEST_CASE(handlers_that_call_each_other_end)
{
    BOOST_TEST(signal_that_ends(look_at_missing_page_of_chained_handlers) == SIGBUS);
}

BOOST_AUTO_TEST_CASE(a_file_that_cannot_be_mapped_is_named)
{
    mapped_part part(-1, "x.bin");
    BOOST_CHECK_EXCEPTION(
        part.look(0, 1, [](const char*) {}),
        std::invalid_argument,
        [](const auto& refusal) {
            return std::string(refusal.what()) ==
                   "recording: x.bin cannot be mapped (Bad file descriptor)";
        });
}
