// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <chrono>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include <sys/socket.h>

/** Reads packets of samples from a stream socket with a receive timeout.
 *
 * A packet is two counts (32 bits each, of samples and tags), the tags, and the samples.
 * In Python, its four reads of the socket and two reductions cost twice as much as the
 * copy of the samples, and took turns with the thread that estimates.
 */
class packet_reader
{
public:
    struct part {
        std::size_t samples = 0;
        std::string tags; // of the packet that begins with this part
        int peak = 0;     // largest magnitude of a component
        bool ended = false;
    };

    packet_reader(int socket, std::size_t sample_bytes, std::size_t tag_bytes)
        : d_socket(socket), d_sample_bytes(sample_bytes), d_tag_bytes(tag_bytes)
    {
    }

    /** What has come of one packet, at most so many samples.
     *
     * Waits until they are complete, the socket's timeout passes, or the stream ends.
     */
    part read(std::int16_t* out, std::size_t most)
    {
        part result;
        if (d_remaining == 0 && !read_head(result.tags)) {
            result.ended = d_ended;
            return result;
        }
        const std::size_t wanted = std::min(most, d_remaining) * d_sample_bytes;
        std::size_t count = 0;
        while (!fill(reinterpret_cast<char*>(out), wanted, count) && !d_ended)
            if (count % d_sample_bytes == 0)
                break;
        result.samples = count / d_sample_bytes;
        result.ended = d_ended && count == 0;
        d_remaining -= result.samples;
        for (std::size_t i = 0; i < count / sizeof(*out); ++i)
            result.peak = std::max(result.peak, std::abs(static_cast<int>(out[i])));
        return result;
    }

private:
    bool read_head(std::string& tags)
    {
        std::uint32_t counts[2];
        if (!extend_head(sizeof(counts)))
            return false;
        std::memcpy(counts, d_head.data(), sizeof(counts));
        if (!extend_head(sizeof(counts) + counts[1] * d_tag_bytes))
            return false;
        tags = d_head.substr(sizeof(counts));
        d_remaining = counts[0];
        d_head.clear();
        d_head_count = 0;
        return true;
    }

    bool extend_head(std::size_t bytes)
    {
        d_head.resize(bytes);
        return fill(d_head.data(), bytes, d_head_count);
    }

    bool fill(char* data, std::size_t wanted, std::size_t& count)
    {
        while (count < wanted) {
            const auto received =
                ::recv(d_socket, data + count, wanted - count, MSG_WAITALL);
            if (received > 0)
                count += received;
            else if (received == 0 || errno != EINTR) {
                d_ended = received == 0 || (errno != EAGAIN && errno != EWOULDBLOCK);
                return false;
            }
        }
        return true;
    }

    int d_socket;
    std::size_t d_sample_bytes, d_tag_bytes, d_remaining = 0, d_head_count = 0;
    std::string d_head;
    bool d_ended = false;
};

/** Writes packets that a packet_reader reads, to a stream socket with a send timeout.
 *
 * What arrives within an interval is sent together. `ended` is set by any thread: nothing
 * is sent any more, not even the rest of a packet.
 */
class packet_writer
{
public:
    std::atomic<bool> ended{ false };
    std::atomic<bool> waiting{ false }; // the other process is slower than packets come

    packet_writer(int socket, double interval_s)
        : d_socket(socket),
          d_interval(std::chrono::duration_cast<clock::duration>(
              std::chrono::duration<double>(interval_s)))
    {
    }

    /** Whether all of a packet was sent: its head, and the samples of each antenna. */
    bool write(const std::string& head,
               const std::vector<const void*>& inputs,
               std::size_t count)
    {
        const void* samples = inputs.front();
        if (inputs.size() > 1) {
            d_beside.resize(count * inputs.size());
            for (std::size_t antenna = 0; antenna < inputs.size(); ++antenna) {
                const auto* const own =
                    static_cast<const std::uint32_t*>(inputs[antenna]);
                for (std::size_t i = 0; i < count; ++i)
                    d_beside[i * inputs.size() + antenna] = own[i];
            }
            samples = d_beside.data();
        }
        // As one message, so that the other process is woken once.
        iovec parts[] = { { const_cast<char*>(head.data()), head.size() },
                          { const_cast<void*>(samples),
                            count * inputs.size() * sizeof(std::uint32_t) } };
        if (!send(parts))
            ended = true;
        if (ended)
            return false;
        std::this_thread::sleep_until(d_next);
        d_next = clock::now() + d_interval;
        return true;
    }

private:
    using clock = std::chrono::steady_clock;

    bool send(iovec (&parts)[2])
    {
        msghdr message{};
        message.msg_iov = parts;
        message.msg_iovlen = 2;
        while (parts[1].iov_len > 0 && !ended) {
            const auto sent = ::sendmsg(d_socket, &message, MSG_NOSIGNAL);
            waiting = sent < 0 && (errno == EAGAIN || errno == EWOULDBLOCK);
            if (sent < 0 && !waiting && errno != EINTR)
                return false; // the other process has gone
            auto rest = static_cast<std::size_t>(std::max<ssize_t>(sent, 0));
            for (iovec& part : parts) {
                const auto own = std::min(rest, part.iov_len);
                part.iov_base = static_cast<char*>(part.iov_base) + own;
                part.iov_len -= own;
                rest -= own;
            }
        }
        return true;
    }

    int d_socket;
    clock::duration d_interval;
    clock::time_point d_next;
    std::vector<std::uint32_t> d_beside; // samples of all antennas, side by side
};
