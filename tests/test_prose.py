"""Words that hide the subject of a sentence stay rare in docstrings, messages and the manual."""

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("miho", "baselines", "experiments", "docs")
GENERATED = {ROOT / "docs" / "results", ROOT / "docs" / "gallery"}
CODE = re.compile(
    r"```.*?```|`[^`]*`|\]\([^)]*\)|^ *(?:>>>|\.\.\.) [^\n]*$", re.DOTALL | re.MULTILINE
)
LIMITS = {  # words: pattern, occurrences per 1,000 words
    "what": (r"what", 1.8),
    "that of, those of": (r"(?:that|those) of", 0.4),
    "where": (r"where", 5.0),
    "own": (r"own", 0.6),
    "beside, behind": (r"beside|behind", 0.2),
    "preposition and which": (r"(?:at|by|for|from|in|of|on|to|with) which", 2.0),
    "tell, told": (r"tells?|told", 0.6),
    "go on": (r"go(?:es)? on", 0.2),
    "dear": (r"dear", 0.1),
}
LIMITS_OF_MANUAL = {"own": 1.4}


def texts(path: Path) -> Iterator[tuple[str, str]]:
    """Kind and text of a page, or of each docstring and message of a Python file."""
    source = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        yield "manual", source
        return
    nodes = list(ast.walk(ast.parse(source)))
    formatted = [node for node in nodes if isinstance(node, ast.JoinedStr)]
    pieces = {id(piece) for node in formatted for piece in node.values}
    documented = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        parts = node.values if isinstance(node, ast.JoinedStr) else [node]
        text = "".join(str(p.value) if isinstance(p, ast.Constant) else "{}" for p in parts)
        if isinstance(node, ast.Constant) and id(node) in documented:
            yield "docstrings", text
        elif id(node) not in pieces and len(text.split()) > 3:
            yield "messages", text


def test_evasive_words_are_rare() -> None:
    words: Counter[str] = Counter()
    hits: dict[tuple[str, str], Counter[str]] = defaultdict(Counter)
    paths = [*ROOT.glob("*.md"), *(path for name in FOLDERS for path in (ROOT / name).rglob("*.*"))]
    for path in paths:
        if path.suffix not in (".md", ".py") or GENERATED.intersection(path.parents):
            continue
        for kind, text in texts(path):
            prose = CODE.sub(" ", text)
            words[kind] += len(prose.split())
            for name, (pattern, _) in LIMITS.items():
                found = len(re.findall(rf"\b(?:{pattern})\b", prose, re.IGNORECASE))
                hits[kind, name][str(path.relative_to(ROOT))] += found
    assert set(words) == {"docstrings", "messages", "manual"}
    failures = []
    for (kind, name), by_file in hits.items():
        limit = LIMITS_OF_MANUAL.get(name, LIMITS[name][1]) if kind == "manual" else LIMITS[name][1]
        rate = 1000 * by_file.total() / words[kind]
        if rate > limit:
            worst = ", ".join(f"{file} ({count})" for file, count in (+by_file).most_common(5))
            failures.append(f"{name!r} in {kind}: {rate:.2f} > {limit}; most in {worst}")
    assert not failures, "occurrences per 1,000 words:\n" + "\n".join(failures)
