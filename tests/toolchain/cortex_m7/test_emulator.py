"""The emulated core: calls, faults that say where, the code that a call executes, its stack."""

from __future__ import annotations

import struct
from collections import Counter
from pathlib import Path

import pytest

from neuroflight.toolchain.contract import Region
from neuroflight.toolchain.cortex_m7.arm_policy import compile_arm
from neuroflight.toolchain.cortex_m7.emulator import STACK, CortexM7, FaultError, Program, load_program
from neuroflight.toolchain.errors import BuildError

CODE = """
const int constant = 7;
int variable = 5, zeroed[3];
int sum(int a, int b, int c, int d) { return a + 10 * b + 100 * c + 1000 * d; }
void store(int *where, int what) { *where = what; }
int count(void) { return ++variable + ++zeroed[2]; }
__attribute__((noinline)) int loop(int n)
{
    int s = 0;
    do { __asm__ volatile("" : "+r"(s)); s += n; } while (--n);
    return s;
}
void forever(void) { for (;;) __asm__ volatile("nop"); }
void undefined(void) { __asm__ volatile("udf #0"); }
int deep(void) { volatile char room[1000]; room[0] = 1; return room[0]; }
int flat(void) { return 1; }
int recursive(int n)
{
    volatile char room[1000];
    room[n % 7] = 1;
    return n ? recursive(n - 1) + room[n % 7] : 0;
}
__attribute__((naked)) void marked(void)
{
    __asm__("add r0, #1\\n add r0, #2\\n add r0, #4\\n str r0, [r1, #32]\\n bx lr");
}
__attribute__((naked)) void conditional(int *where)
{
    __asm__("mov r1, r0\\n mov r0, #0\\n cmp r0, r0\\n"
            "itee eq\\n ldreq r2, [r1]\\n movne r0, #64\\n movne r0, #64\\n b.w marked");
}
"""
LINK = ("-nostdlib", "-Wl,-Ttext=0x10000,-Tdata=0x20000000,-z,separate-code,-z,max-page-size=0x1000,-e,sum")


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Program:
    folder = tmp_path_factory.mktemp("program")
    (folder / "program.c").write_text(CODE)
    compile_arm("-std=gnu11", "-O1", *LINK, "program.c", out=folder / "program.elf")
    return load_program(folder / "program.elf")


@pytest.fixture
def core(program: Program) -> CortexM7:
    return CortexM7(program)


def test_result_comes_back_when_all_four_words_are_given(core: CortexM7) -> None:
    assert core.call("sum", 1, 2, 3, 4) == 4321
    with pytest.raises(ValueError, match="5 arguments of sum"):
        core.call("sum", 1, 2, 3, 4, 5)


def test_memory_keeps_what_calls_leave_when_they_follow_each_other(core: CortexM7) -> None:
    place = core.allocate(8)
    core.call("store", place + 4, 77)
    assert struct.unpack("<2i", core.read(place, 8)) == (0, 77)
    assert [core.call("count") for _ in range(2)] == [7, 9], "initialized and zeroed variables are there"
    core.write(core.program.symbol("variable").address, struct.pack("<i", 100))
    assert core.call("count") == 104


@pytest.mark.parametrize(
    ("address", "words"),
    [
        (0x50000000, "a write of 4 bytes at 0x50000000"),
        (0, "a write of 4 bytes at 0x00000000"),
        (STACK.address + STACK.size, f"a write of 4 bytes at 0x{STACK.address + STACK.size:08X}"),
    ],
)
def test_fault_names_function_and_address_when_memory_is_not_there(
    core: CortexM7, address: int, words: str
) -> None:
    with pytest.raises(FaultError, match=rf"^store stopped at store\+0x0: {words}$"):
        core.call("store", address, 1)
    assert core.call("sum", 1, 0, 0, 0) == 1, "the core works on after a fault"


def test_writing_is_a_fault_when_the_place_is_constant(core: CortexM7, program: Program) -> None:
    for name in ("constant", "sum"):
        with pytest.raises(FaultError, match="a write to what is constant, of 4 bytes"):
            core.call("store", program.symbol(name).address, 1)


def test_everything_may_be_written_when_the_memory_is_a_boards(program: Program) -> None:
    core = CortexM7(program, [Region("all", 0, 0x20000)])
    core.call("store", program.symbol("constant").address, 1)
    core.call("store", 0, 1)


def test_fault_says_so_when_a_call_does_not_come_back(core: CortexM7) -> None:
    with pytest.raises(FaultError, match=r"forever did not come back within 1000 instructions, forever\+0x"):
        core.call("forever", instructions=1000)
    with pytest.raises(FaultError, match=r"^undefined stopped at undefined\+0x0: "):
        core.call("undefined")
    with pytest.raises(FaultError, match=r"^recursive stopped at recursive\+0x.*: a write of "):
        core.call("recursive", 1000)


def test_unknown_function_is_refused_when_called(core: CortexM7) -> None:
    with pytest.raises(BuildError, match=r"program.elf has no nothing;"):
        core.call("nothing")


def test_runs_of_code_are_recorded_when_asked_and_only_then(core: CortexM7, program: Program) -> None:
    core.call("loop", 3)
    with core.recording() as runs:
        core.call("loop", 25)
        first = Counter(runs)
        runs.clear()
        core.call("loop", 3)
        second = Counter(runs)
    core.call("loop", 3)
    assert Counter(runs) == second
    loop = program.symbol("loop")
    assert all(loop.address <= address < loop.address + loop.size for address, _ in first)
    assert sum(first.values()) - sum(second.values()) == 25 - 3
    assert max(first.values()) >= 24


def test_stack_is_exact_when_a_call_takes_some(core: CortexM7) -> None:
    assert core.stack_bytes("flat") == 0
    deep = core.stack_bytes("deep")
    assert 1000 <= deep <= 1008
    assert core.stack_bytes("recursive", 3) == 4 * core.stack_bytes("recursive", 0)


def test_file_is_refused_when_it_is_no_program_for_the_core(tmp_path: Path) -> None:
    with pytest.raises(BuildError, match="cannot read the program"):
        load_program(tmp_path / "missing.elf")
    (tmp_path / "text.elf").write_text("no")
    with pytest.raises(BuildError, match="not an ELF file"):
        load_program(tmp_path / "text.elf")
    with pytest.raises(BuildError, match="is for x64, expected ARM"):
        load_program(Path("/proc/self/exe"))


def test_compiler_is_named_in_one_line_when_it_is_missing_or_refuses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "wrong.c").write_text("int f(void) { return missing; }")
    with pytest.raises(
        BuildError, match=r"cannot build wrong.elf: wrong.c:1.*'missing' undeclared"
    ) as caught:
        compile_arm("wrong.c", out=tmp_path / "wrong.elf")
    assert "\n" not in str(caught.value)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(
        BuildError, match="arm-none-eabi-gcc is not installed; run: sudo apt-get install gcc-arm"
    ):
        compile_arm("wrong.c", out=tmp_path / "wrong.elf")


def test_what_is_behind_an_it_block_is_executed_when_its_accesses_are_counted(core: CortexM7) -> None:
    place = core.allocate(64)
    assert core.accesses(Region("counted", place, 4), "conditional", place) == 1
    assert core.read(place + 32, 4) == struct.pack("<i", 7)
