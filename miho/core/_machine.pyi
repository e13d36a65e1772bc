from typing import Any

from miho.quantities import Array, Integers

def tape(counts: object, code: object, constants: Array, fills: object, level: int = -1) -> Any: ...
def evaluate(tape: Any, thetas: Array, X: Array, out: Array) -> None: ...
def mean_squares(tape: Any, thetas: Array, X: Array, y: Array, first: int, out: Array) -> None: ...
def run_bracket(
    calls: Integers,
    kept: Any,
    X: Array,
    y: Array,
    numbers: Array,
    counts: Integers,
    R: Array,
    stored: Array,
    place: Integers,
    order: Integers,
    box: tuple[Any, ...],
    level_rows: Integers,
    minima: tuple[Any, ...],
    settings: tuple[Any, ...],
    most: int,
    best: float,
    target: float,
    at: Integers,
    losses: Array,
    thetas: Array,
    tally: Integers,
    room: Array,
) -> int: ...
def fold(T: Array, columns: Array, rows: int, n: int) -> None: ...
def solve_in_box(R: Array, q: Array, scale: Array, low: Array, high: Array, s: Array) -> None: ...
def climb(
    tape: Any,
    X: Array,
    y: Array,
    first: int,
    steps: tuple[Any, ...],
    best: float,
    target: float,
    at: Integers,
    losses: Array,
    thetas: Array,
) -> tuple[int, int, int, int]: ...
def fit_many(
    tape: Any,
    X: Array,
    y: Array,
    ends: Integers,
    shared: bool,
    box: tuple[Any, ...],
    starts: tuple[Any, ...],
    which: Integers,
    thetas: Array,
    squares: Array,
    covariance: Array,
    flags: Any,
) -> None: ...
def solve_trajectories(
    rates: Any, outputs: Any, thetas: Array, course: tuple[Any, ...], out: Array
) -> None: ...
def derive_trajectory(
    rates: Any,
    outputs: Any,
    rate_slopes: tuple[Any, Integers],
    output_slopes: tuple[Any, Integers],
    theta: Array,
    course: tuple[Any, ...],
    out: Array,
) -> None: ...
def update_population(
    tape: Any,
    sizes: tuple[int, int, int, int, int, int],
    rules: Array,
    row: Array,
    memory: Array,
    estimate: Array,
) -> None: ...
def mixture_reach(
    weights: Array, means: Array, deviations: Array, centre: Array, probability: float, out: Array
) -> None: ...
def address(tape: Any) -> int: ...
def functions() -> tuple[int, int]: ...
def levels() -> tuple[str, ...]: ...
def operations() -> tuple[str, ...]: ...
def sources() -> int: ...
