"""The chart library of a page, Vega with Vega-Lite and Vega-Embed, as one script.

vl-convert-python contains them. Bundling takes seconds, so the script is kept in the user's cache
folder.
"""

from __future__ import annotations

import contextlib
from importlib.metadata import version
from pathlib import Path

from markupsafe import Markup

from miho.study import write_text
from miho.study.identity import sha256

PACKAGE = "vl-convert-python"
SNIPPET = "window.vegaEmbed = vegaEmbed;"
"""Export of the bundle to the script of the page."""


def vega(cache: Path | None = None) -> Markup | None:
    """The script, from the cache folder if possible; None if vl-convert is not installed."""
    try:
        import vl_convert
    except ImportError:
        return None
    import pooch  # slow to import

    cache = Path(pooch.os_cache("miho")) if cache is None else cache
    path = cache / f"vega-{version(PACKAGE)}-{sha256(SNIPPET)[:12]}.js"
    script = _stored(path)
    if script is None:
        bundle = vl_convert.javascript_bundle(SNIPPET)
        script = bundle.replace("</script", "<\\/script")  # equivalent in a string
        with contextlib.suppress(OSError):  # without a cache it is bundled again
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, f"{_head(script)}\n{script}")
    return Markup(script)  # noqa: S704 - nothing in it closes the element


def _stored(path: Path) -> str | None:
    """The script in a file that begins with its digest; None if it is missing or damaged."""
    try:
        head, _, script = path.read_text(encoding="utf-8").partition("\n")
    except (OSError, UnicodeDecodeError):
        return None
    return script if head == _head(script) else None


def _head(script: str) -> str:
    return f"// sha256 {sha256(script)}"
