# SPDX-License-Identifier: GPL-3.0-or-later
"""What other modules build with: the CMake package, its kernels, and a matching pybind11."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce._config import DATA_DIR

ROOT = DATA_DIR.parent
EXAMPLE = ROOT / "examples" / "kernel"
GCC = "__pybind11_internals_v4_gcc_libstdcpp_cxxabi1017__"
CLANG = "__pybind11_internals_v4_clang_libstdcpp_cxxabi1002__"
NEWER = "__pybind11_internals_v5_gcc_libstdcpp_cxxabi1017__"


def run(*command, **options):
    return subprocess.run(
        [str(part) for part in command], capture_output=True, text=True, timeout=300, **options
    )


def build_tree():
    """The tree whose compiled modules this test uses."""
    from gnuradio.wiforce import wiforce_kernels

    return Path(wiforce_kernels.__file__).parents[3]


def write_frames(path, frames, level, noise):
    """Frames of 720 samples, noise on top, and the powers of both in the averaged part."""
    rng = np.random.default_rng(22)
    symbol = np.exp(1j * np.pi * np.arange(64) ** 2 / 64) * level
    signal = np.zeros((frames, 720), complex)
    signal[:, :320] = np.tile(symbol, 5)
    signal += noise / np.sqrt(2) * (rng.standard_normal((frames, 720, 2)) @ [1, 1j])
    parts = np.stack([signal.real, signal.imag], axis=-1)
    np.rint(parts * 32768).astype("<i2").tofile(path)


def test_find_package_example_links_a_kernel_and_reads_a_file(tmp_path, long_run):
    """Headers and library were not exported: no other module could use a kernel."""
    prefix = tmp_path / "prefix"
    installed = run("cmake", "--install", build_tree(), "--prefix", prefix)
    assert installed.returncode == 0, installed.stderr
    config = next(prefix.rglob("gnuradio-wiforceConfig.cmake")).parent
    write_frames(tmp_path / "frames.ci16", 2500, 0.25, 0.01)
    for package in (config, build_tree() / "package") if long_run else (config,):
        tree = tmp_path / package.parts[-1]
        configured = run(
            *("cmake", "-S", EXAMPLE, "-B", tree, f"-Dgnuradio-wiforce_DIR={package}"),
            "-DCMAKE_CXX_FLAGS=-Wall -Wextra -Werror",
        )
        assert configured.returncode == 0 and not configured.stderr, configured.stderr
        built = run("cmake", "--build", tree)
        assert built.returncode == 0, built.stdout + built.stderr
        printed = run(tree / "frame_levels", tmp_path / "frames.ci16", 720)
        assert printed.returncode == 0, printed.stderr
        lines = printed.stdout.splitlines()
        assert [line.split(":")[0] for line in lines] == [
            "frames 0 to 999",
            "frames 1000 to 1999",
            "frames 2000 to 2499",
        ]
        for line in lines:
            level, noise = (float(part.split()[-2]) for part in line.split(":")[1].split(","))
            assert level == pytest.approx(20 * np.log10(0.25), abs=0.05)
            # The smallest of three differences at each sample.
            assert -60 < noise < -40
    refused = run(tree / "frame_levels", tmp_path / "missing", 720)
    assert refused.returncode == 1 and "missing" in refused.stderr


def match(tmp_path, theirs, ours):
    """What the configuration says of two identifiers, each read from a file like a module."""
    script = [f"include({ROOT}/cmake/CheckPybind11.cmake)"]
    for name, identifier in (("theirs", theirs), ("ours", ours)):
        file = tmp_path / f"{name}.so"
        file.write_bytes(b"\x7fELF\0get_internals: could not\0" + identifier.encode() + b"\0\xff")
        script.append(f"wiforce_pybind11_id({file} {name})")
    script.append('wiforce_match_pybind11("${theirs}" "${ours}" 2.10.3 definitions)')
    script.append('message("definitions [${definitions}]")')
    (tmp_path / "match.cmake").write_text("\n".join(script))
    return run("cmake", "-P", tmp_path / "match.cmake")


@pytest.mark.parametrize(
    ("theirs", "ours", "words", "definitions"),
    [
        (GCC, GCC, f"shares types with GNU Radio's modules: {GCC}", ""),
        # A build by Clang could not be imported beside a GNU Radio built by GCC.
        (GCC, CLANG, "", 'PYBIND11_COMPILER_TYPE="_gcc";PYBIND11_BUILD_ABI="_cxxabi1017"'),
        ("no identifier", GCC, "could not determine", ""),
    ],
)
def test_pybind11_that_can_share_types_is_accepted_or_compiled_as_gnuradios(
    tmp_path, theirs, ours, words, definitions
):
    matched = match(tmp_path, theirs, ours)
    said = matched.stdout + matched.stderr
    assert matched.returncode == 0 and words in said and f"definitions [{definitions}]" in said


@pytest.mark.parametrize(
    ("theirs", "ours"),
    [(GCC, NEWER), (NEWER, GCC), (GCC, GCC.replace("libstdcpp", "libcpp")), (GCC, CLANG + "x__")],
)
def test_pybind11_that_cannot_share_types_ends_the_configuration_with_advice(
    tmp_path, theirs, ours
):
    """The build succeeded, and the import failed with a message that names no cause."""
    matched = match(tmp_path, theirs, ours)
    assert matched.returncode != 0
    message = " ".join(matched.stderr.split())
    assert f"GNU Radio: {theirs} this build: {ours}" in message
    assert "-Dpybind11_DIR=" in message and "apt install pybind11-dev" in message
