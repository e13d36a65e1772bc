"""Configurations of others: what expands, goes deep or holds itself is refused at once."""

from pathlib import Path

import pytest

from experiments.app.safety import ReceivedError, check_file, check_folder

LAUGHS = "\n".join(
    ["a0: &a0 [lol]", *(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 8))]
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (LAUGHS, "expands to more than"),
        ("a: " + "[" * 3000 + "]" * 3000, "nested deeper"),
        ("a: &a [*a]", "contains itself"),
        ("a: &a {b: {c: *a}}", "contains itself"),
        ("a: [", "is not YAML"),
        ("#" * (2 << 20), "larger than"),
    ],
)
def test_a_bomb_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    with pytest.raises(ReceivedError, match=message) as caught:
        check_folder(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_device_is_refused() -> None:
    with pytest.raises(ReceivedError, match="not a regular file"):
        check_file(Path("/dev/zero"))


def test_our_own_configurations_are_fine() -> None:
    check_folder(Path(__file__).parents[2] / "conf")
