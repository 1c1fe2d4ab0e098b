// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernel/recording/mapped_part.h"

#include <boost/test/unit_test.hpp>

#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <csetjmp>
#include <csignal>
#include <cstdio>
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

sigjmp_buf back;

} // namespace

BOOST_AUTO_TEST_CASE(a_part_holds_the_bytes_from_any_place_on)
{
    const counted_file file;
    mapped_part part(file.number);
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
    mapped_part part(file.number);
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
    std::signal(SIGBUS, [](int) { siglongjmp(back, 1); });
    const counted_file file;
    mapped_part part(file.number);
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
