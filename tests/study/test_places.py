"""Names that may be folders, and folders that stay below their root."""

from pathlib import Path

import pytest

from miho.study import Identity
from miho.study.identity import check_name, inside

GOOD = ["a", "0", "_x", "miho", "pacejka-tire_lf", "v1.2", "a" * 100, "console", "com10", "nulls"]
BAD = [
    "", ".", "..", "a.", "a ", " a", ".a", "-a", "a/b", "a\\b", "a\0", "a\n", "a" * 101, "con",
    "CON.txt", "Lpt1", "p\u0430cejka", "\uff41", "a:b", None, 3, b"a",
]  # fmt: skip


@pytest.mark.parametrize("name", GOOD)
def test_plain_names(name: str) -> None:
    assert check_name("problem", name) == name


@pytest.mark.parametrize("name", BAD)
def test_other_names_are_refused_in_one_line(name: object) -> None:
    with pytest.raises(ValueError, match=r"^optimizer name .* cannot name a folder; ") as caught:
        Identity("x", name, 0, {}, "c", "d")  # type: ignore[arg-type]
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400


def test_a_place_below_the_root(tmp_path: Path) -> None:
    assert inside(tmp_path, "a", "b") == tmp_path / "a" / "b"


@pytest.mark.parametrize("names", [("..",), ("a", ".."), ("a/../..",), ("/etc",), ("",), (".",)])
def test_names_that_lead_elsewhere(tmp_path: Path, names: tuple[str, ...]) -> None:
    with pytest.raises(PermissionError, match="leads out of the folder of results"):
        inside(tmp_path, *names)


def test_links(tmp_path: Path) -> None:
    """The root may be reached through a link; what is below may not lead out of it by one."""
    root, outside = tmp_path / "root", tmp_path / "outside"
    (root / "real").mkdir(parents=True)
    outside.mkdir()
    (tmp_path / "link").symlink_to(root)
    assert inside(tmp_path / "link", "real") == tmp_path / "link" / "real"
    (root / "within").symlink_to(root / "real")
    assert inside(root, "within", "x") == root / "within" / "x"
    (root / "out").symlink_to(outside)
    (root / "nowhere").symlink_to(tmp_path / "not there")
    (root / "loop").symlink_to(root / "loop")
    (root / "later").symlink_to(root / "not yet")
    for name in ("out", "nowhere", "loop", "later"):
        with pytest.raises(PermissionError, match="leads out"):
            inside(root, name, "x")
