"""Which processors are told apart, and how many doubles each takes at once."""

from dataclasses import replace

import pytest

from piaffe.codegen.cpu import Cpu, parse, this_cpu

XEON = """processor\t: 0
vendor_id\t: GenuineIntel
cpu family\t: 6
model\t\t: 207
model name\t: Intel(R) Xeon(R) Processor
cpu MHz\t\t: 2300.0
flags\t\t: fpu sse2 fma avx avx2 avx512f avx512dq
"""
EPYC = XEON.replace("GenuineIntel", "AuthenticAMD").replace("207", "49").replace(" avx512f avx512dq", "")
ARM = """processor\t: 0
Features\t: fp asimd evtstrm aes
CPU implementer\t: 0x41
CPU architecture: 8
CPU part\t: 0xd0b
"""
BIG_LITTLE = ARM + ARM.replace("0xd0b", "0xd05").replace("evtstrm aes", "evtstrm")


@pytest.mark.parametrize(
    ("text", "machine", "width", "native"),
    [
        (XEON, "x86_64", 8, "-march=native"), (EPYC, "x86_64", 4, "-march=native"),
        (ARM, "aarch64", 4, "-mcpu=native"), ("", "riscv64", 1, "-march=native"),
        (EPYC.replace("avx2", "").replace(" avx", ""), "x86_64", 2, "-march=native"),
    ],
)  # fmt: skip
def test_vector_width_follows_the_features(text: str, machine: str, width: int, native: str) -> None:
    cpu = parse(text, machine)
    assert (cpu.vector_width, cpu.native) == (width, native)


def test_a_feature_that_one_core_lacks_does_not_count() -> None:
    assert parse(BIG_LITTLE, "aarch64").features == {"fp", "asimd", "evtstrm"}


def test_the_name_is_for_people() -> None:
    assert str(parse(XEON, "x86_64")) == "Intel(R) Xeon(R) Processor"
    assert str(parse("", "riscv64")) == "riscv64"


def test_fingerprints_differ_where_code_may_not_run() -> None:
    cpu = parse(XEON, "x86_64", "glibc 2.36")
    others: list[Cpu] = [
        parse(EPYC, "x86_64", "glibc 2.36"), replace(cpu, libc="glibc 2.31"), replace(cpu, machine="aarch64"),
        replace(cpu, features=cpu.features - {"avx512f"}), replace(cpu, identity=()),
    ]  # fmt: skip
    assert len({cpu.fingerprint, *(other.fingerprint for other in others)}) == 1 + len(others)


def test_a_fingerprint_does_not_depend_on_clock_or_number_of_cores() -> None:
    again = XEON + XEON.replace("processor\t: 0", "processor\t: 1").replace("2300.0", "3100.0")
    assert parse(again, "x86_64").fingerprint == parse(XEON, "x86_64").fingerprint


def test_this_machine_has_a_fingerprint() -> None:
    assert len(this_cpu().fingerprint) == 32
    assert this_cpu().vector_width in (1, 2, 4, 8)
