"""C built on first use: once, for what it is made of, and in one line when it cannot be."""

from dataclasses import replace
from pathlib import Path

import pytest

from neuroflight.sim import compiled
from neuroflight.sim.compiled import Source
from neuroflight.toolchain.errors import BuildError


@pytest.fixture
def source(tmp_path: Path) -> Source:
    part = tmp_path / "part"
    part.mkdir()
    (part / "api.h").write_text("#include <stdint.h>\n\nuint32_t doubled(uint32_t value);\n")
    (part / "doubled.c").write_text(
        '#include "api.h"\n\nuint32_t doubled(uint32_t value)\n{\n\treturn value * 2u;\n}\n'
    )
    return Source("doubled", "the doubler", (part,))


def test_python_calls_what_the_header_declares(source: Source, tmp_path: Path) -> None:
    assert compiled.load(source, tmp_path).lib.doubled(21) == 42


def test_a_library_is_built_once_while_nothing_has_changed(source: Source, tmp_path: Path) -> None:
    first = compiled.build(source, tmp_path)
    made = first.stat().st_mtime_ns
    assert compiled.build(source, tmp_path) == first
    assert first.stat().st_mtime_ns == made


@pytest.mark.parametrize("change", ["source", "flags", "versions"])
def test_another_library_is_built_when_something_has_changed(
    source: Source, tmp_path: Path, change: str
) -> None:
    first = compiled.build(source, tmp_path)
    if change == "source":
        code = source.parts[0] / "doubled.c"
        code.write_text(code.read_text().replace("2u", "3u"))
    changed = {"source": {}, "flags": {"flags": ("-O1",)}, "versions": {"versions": ("2",)}}
    assert compiled.build(replace(source, **changed[change]), tmp_path) != first  # type: ignore[arg-type]


def test_one_line_says_so_when_there_is_no_compiler(
    source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "COMPILERS", ("no-such-compiler",))
    with pytest.raises(BuildError, match="the doubler needs a C compiler"):
        compiled.build(source, tmp_path)


def test_one_line_says_so_when_it_does_not_compile(source: Source, tmp_path: Path) -> None:
    (source.parts[0] / "wrong.c").write_text("int wrong(void) { return nothing; }\n")
    with pytest.raises(BuildError, match=r"the doubler does not build with .*wrong\.c:1") as caught:
        compiled.build(source, tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.glob("doubled-*.so"))
