"""Arguments of commands without Hydra."""

import pytest

from experiments.app.console import chosen_names


def test_names_are_chosen_or_all_of_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def chosen(*words: str) -> list[str]:
        monkeypatch.setattr("sys.argv", ["experiments/gallery.py", *words])
        return list(chosen_names("Run the examples.", ["tire", "prior"]))

    assert chosen() == ["tire", "prior"]
    assert chosen("prior") == ["prior"]
    with pytest.raises(SystemExit, match="0"):
        chosen("--help")
    assert "usage: python -m experiments.gallery" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="2"):
        chosen("prior", "tyre")
    assert capsys.readouterr().err.endswith("error: tyre is unknown; expected tire, prior\n")
