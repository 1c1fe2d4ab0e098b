// SPDX-License-Identifier: GPL-3.0-or-later
#include "kernels/kernels.h"

#include <gnuradio/block.h>
#include <gnuradio/block_detail.h>
#include <gnuradio/buffer.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>

#include <sys/socket.h>

/*
 * Reads packets of samples from a stream socket with a receive timeout.
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

    // What has come of one packet, at most so many samples. Waits until they are
    // complete, the socket's timeout passes, or the stream ends.
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

static py::tuple read_part(packet_reader& reader, std::int16_t* out, std::size_t most)
{
    packet_reader::part part;
    {
        py::gil_scoped_release others;
        part = reader.read(out, most);
    }
    return py::make_tuple(part.samples, py::bytes(part.tags), part.peak, part.ended);
}

void bind_packets(py::module& m)
{
    py::class_<packet_reader>(m, "packet_reader", "Reads packets from a stream socket.")
        .def(py::init<int, std::size_t, std::size_t>(),
             "socket"_a,
             "sample_bytes"_a,
             "tag_bytes"_a)
        .def(
            "read",
            [](packet_reader& reader, py::array_t<std::int16_t, py::array::c_style> out) {
                return read_part(reader, out.mutable_data(), out.shape(0));
            },
            py::arg("out").noconvert(),
            R"(Reads a part of a packet into int16 (n, 2 antennas): the number of samples,
0 where nothing comes within the socket's timeout; the packed tags of a packet that
begins; the largest magnitude; whether the stream has ended.)")
        .def(
            "read_to",
            [](packet_reader& reader, const gr::block& block, std::size_t most) {
                const auto output = block.detail()->output(0);
                return read_part(
                    reader, static_cast<std::int16_t*>(output->write_pointer()), most);
            },
            "block"_a,
            "most"_a,
            "The same, into the output of a block that is being called.");
}
