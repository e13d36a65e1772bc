"""The authors' sample data: found, downloaded, or one line saying what to do."""

import gc
import http.server
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from miho.vehicle.data import DataUnavailableError, load_seong_sample
from miho.vehicle.data.seong import FILE, sample_file
from miho.vehicle.models import Pacejka


@pytest.fixture
def original(reference_data: Path) -> Path:
    return reference_data / "seong_sample" / FILE


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        pass


@pytest.fixture
def server(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """A web server on this machine, and the folder it serves."""
    folder = tmp_path / "served"
    folder.mkdir()

    def handler(*args: object) -> Quiet:
        return Quiet(*args, directory=str(folder))

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as web:
        thread = threading.Thread(target=web.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{web.server_port}", folder
        web.shutdown()
        thread.join()
    with warnings.catch_warnings():  # pooch leaves the socket of a refused download to be collected
        warnings.simplefilter("ignore", ResourceWarning)
        gc.collect()


def test_it_is_read_from_the_given_folder(
    monkeypatch: pytest.MonkeyPatch, reference_data: Path
) -> None:
    monkeypatch.setenv("MIHO_DATA_DIR", str(reference_data))
    a, b = load_seong_sample("a"), load_seong_sample("b")
    assert len(a) == len(b) == 300
    assert a["alpha"][0] == -0.32426
    assert (a["Fy"][0], b["Fy"][0]) == (2368.0, 3736.6)
    assert np.corrcoef(a["alpha"], a["Fy"])[0, 1] < -0.8, "ISO-W: positive slip, negative force"


@pytest.mark.parametrize(
    ("tire", "error", "theta"),
    [
        ("a", 391.33, [17.35, 1.665, 2655.7, -0.0074, 116.4]),
        ("b", 389.19, [18.14, 1.712, 3440.3, -0.01136, 271.3]),
    ],
)
def test_known_optima(
    monkeypatch: pytest.MonkeyPatch,
    reference_data: Path,
    tire: str,
    error: float,
    theta: list[float],
) -> None:
    """The optima that 1,000 starts of an independent least-squares fit agree on."""
    monkeypatch.setenv("MIHO_DATA_DIR", str(reference_data))
    data, model = load_seong_sample(tire), Pacejka()
    fit = least_squares(
        lambda p: model.predict(p[None], data["alpha"])[0] - data["Fy"],
        [15, 1.5, 3000, 0, 0],
        x_scale=[10, 1, 1000, 0.01, 100],
    )
    assert np.sqrt(np.mean(fit.fun**2)) == pytest.approx(error, abs=0.01)
    assert np.abs(fit.x) == pytest.approx(np.abs(theta), rel=6e-3)


def test_download(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, server: tuple[str, Path], original: Path
) -> None:
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    url, folder = server
    (folder / FILE).write_bytes(original.read_bytes())
    cache = tmp_path / "cache"
    path = sample_file(f"{url}/{FILE}", cache)
    assert path.read_bytes() == original.read_bytes()
    (folder / FILE).unlink()
    assert sample_file(f"{url}/{FILE}", cache) == path, "the second call needs no server"


@pytest.mark.parametrize("served", [b"something else", None])
def test_a_wrong_or_absent_download_is_one_line(
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    server: tuple[str, Path],
    served: bytes | None,
) -> None:
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    url, folder = server
    if served is not None:
        (folder / FILE).write_bytes(served)
    with pytest.raises(DataUnavailableError, match="set MIHO_DATA_DIR") as error:
        sample_file(f"{url}/{FILE}", tmp_path / "cache")
    assert "\n" not in str(error.value)
    assert not list((tmp_path / "cache").glob("*")), "nothing wrong stays in the cache"


def test_offline_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("MIHO_DATA_DIR", raising=False)
    with pytest.raises(DataUnavailableError, match="ConnectionError"):
        sample_file(f"http://127.0.0.1:9/{FILE}", tmp_path)


def test_a_changed_file_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / FILE).write_text("0.1,2,3\n")
    monkeypatch.setenv("MIHO_DATA_DIR", str(tmp_path))
    with pytest.raises(DataUnavailableError, match="SHA-256 differs"):
        load_seong_sample("a")
    with pytest.raises(ValueError, match="tires 'a' and 'b'"):
        load_seong_sample("c")
