// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

namespace gr::wiforce::kernel {

/*
 * Reads of a mapped file that may be cut short, or whose disk may fail, at any time: the
 * system then sends SIGBUS to the thread that reads.
 *
 * The handler is the process's; a SIGBUS of anything else goes to the handler before it.
 */
class mapped_read
{
public:
    // Installs the handler.
    static void prepare();

    // Calls read(), which must own nothing that needs to be released. False when the file
    // did not hold what it wanted; read() was then left where it was.
    template <class Read>
    static bool succeeds(const Read& read)
    {
        return attempt([](const void* call) { (*static_cast<const Read*>(call))(); },
                       &read);
    }

private:
    static bool attempt(void (*call)(const void*), const void* read);
};

} // namespace gr::wiforce::kernel
