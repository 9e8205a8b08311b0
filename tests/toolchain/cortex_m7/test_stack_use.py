"""The deepest stack, of programs so small that it can be added up by hand."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from neuroflight.toolchain.cortex_m7.arm_policy import compile_arm
from neuroflight.toolchain.cortex_m7.stack_use import EXCEPTION_BYTES, StackError, StackUse, stack_use

# Functions of a known appetite: `take` reserves at least so many bytes that the compiler cannot do without.
PROGRAM = """
__attribute__((noinline)) void take(volatile char *p) { *p = 1; }
#define FRAME(bytes) volatile char room[bytes]; take(room)
#define QUIET __attribute__((noinline))
%s
#ifndef OWN_HANDLERS
void gyro_sample_handler(void) { FRAME(100); }
void motors_answers_handler(void) { FRAME(8); }
void tick_handler(void) { FRAME(300); }
void motors_moved_handler(void) { FRAME(20); }
void gyro_edge_handler(void) { FRAME(40); }
#endif
void fault_handler(void) { }
__attribute__((section(".stack"), used)) char stack[4096];
"""


def use(folder: Path, text: str, name: str = "main.c", *flags: str) -> StackUse:
    """The stack of a program whose functions are `text`, linked with `flags`."""
    objects = folder / "obj"
    objects.mkdir()
    (objects / name).write_text(PROGRAM % text)
    compile_arm("-c", "-g", "-O1", "-fno-inline", "-fstack-usage", name, out=objects / "program.o")
    compile_arm("-nostdlib", "-Wl,-e,reset_handler", *flags, "obj/program.o", out=folder / "program.elf")
    return stack_use(folder / "program.elf", objects)


def told(folder: Path, function: str) -> int:
    """What the compiler says of one function."""
    words = (folder / "obj" / "program.su").read_text()
    found = re.search(rf":{function}\t(\d+)\t", words)
    assert found is not None
    return int(found[1])


def test_the_deepest_path_is_found_and_interrupts_come_on_top_when_added(tmp_path: Path) -> None:
    found = use(
        tmp_path,
        "QUIET void deep(void) { FRAME(500); } QUIET void flat(void) { FRAME(8); }"
        "void reset_handler(void) { flat(); deep(); flat(); }",
    )
    assert found.thread.path == ("reset_handler", "deep", "take")
    assert found.thread.size == sum(told(tmp_path, name) for name in found.thread.path)
    assert [level.path for level in found.interrupts] == [
        ("tick_handler", "take"),  # of two handlers that cannot interrupt each other the deeper
        ("motors_moved_handler", "take"),
        ("gyro_edge_handler", "take"),
        ("fault_handler",),
    ]
    assert found.worst == found.thread.size + sum(level.size for level in found.interrupts)
    assert found.worst > 500 + 300 + 40 + 3 * EXCEPTION_BYTES
    assert (found.size, found.margin) == (4096, 4096 - found.worst)


def test_a_call_through_a_table_goes_to_its_deepest_function_when_followed(tmp_path: Path) -> None:
    found = use(
        tmp_path,
        "static void small(void) { FRAME(16); } static void large(void) { FRAME(700); }"
        "static void (*const rows[])(void) = {small, large};"
        "void reset_handler(void) { volatile int i = 0; rows[i](); }",
    )
    assert found.thread.path == ("reset_handler", "large", "take")


def test_a_jump_at_the_end_of_a_function_is_a_call_when_followed(tmp_path: Path) -> None:
    found = use(
        tmp_path, "void last(void); void reset_handler(void) { last(); } void last(void) { FRAME(64); }"
    )
    assert found.thread.path == ("reset_handler", "last", "take")


def test_a_clone_is_found_behind_the_linkers_veneer_when_it_lies_too_far_for_a_call(tmp_path: Path) -> None:
    found = use(
        tmp_path,
        'QUIET __attribute__((section(".far"))) void away(void) __asm__("away.constprop.0");'
        "void away(void) { FRAME(200); }"
        "void reset_handler(void) { away(); away(); }",
        "main.c",
        "-Wl,--section-start=.far=0x08000000",
    )
    assert found.thread.path == (
        *("reset_handler", "__away.constprop.0_veneer", "away.constprop.0", "__take_veneer", "take"),
    )


def test_what_assembly_pushes_is_counted_when_the_compiler_does_not_say(tmp_path: Path) -> None:
    found = use(
        tmp_path,
        'void pushes(void); __asm(".thumb_func\\n.global pushes\\n.type pushes, %function\\npushes:\\n'
        "push {r4-r7, lr}\\nvpush {d8-d9}\\nsub sp, #24\\nadd sp, #24\\nvpop {d8-d9}\\n"
        'pop {r4-r7, pc}\\n.size pushes, . - pushes\\n");'
        "void reset_handler(void) { pushes(); }",
    )
    assert found.thread.path == ("reset_handler", "pushes")
    assert found.thread.size - told(tmp_path, "reset_handler") == 5 * 4 + 2 * 8 + 24


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "int n; QUIET void b(void); QUIET void a(void) { if (n) b(); n++; }"
            "void b(void) { if (n) a(); n++; }"
            "void reset_handler(void) { a(); }",
            "a calls b calls a: no bound for its stack",
        ),
        (
            "void (*anywhere)(void); void reset_handler(void) { anywhere(); }",
            r"reset_handler calls through a pointer \(main.c:\d+\); "
            r"say in toolchain/cortex_m7/stack_use.py where",
        ),
        (
            "void reset_handler(void) { volatile int n = 9; volatile char room[n]; take(room); }",
            "reset_handler in .*main.c takes a stack of variable size",
        ),
        ("int other; void start(void) {}", "the image has no function reset_handler"),
    ],
)
def test_no_figure_is_given_when_it_cannot_be_known(text: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(StackError, match=says):
        use(tmp_path, text)


def test_the_compilers_word_is_asked_for_when_it_is_missing(tmp_path: Path) -> None:
    with pytest.raises(StackError, match="compile with -fstack-usage"):
        stack_use(tmp_path / "any.elf", tmp_path)


def test_a_named_place_must_exist_when_a_pointer_goes_there(tmp_path: Path) -> None:
    with pytest.raises(StackError, match=r"runtime\.c:runtime_background, which .* names, is not in"):
        use(tmp_path, "void (*later)(void); void reset_handler(void) { later(); }", name="hal.c")
