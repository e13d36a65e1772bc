"""Enhanced scatter search with local searches by least squares."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from miho.methods.descent import METHODS, SMALLEST_TOLERANCE, local_search
from miho.methods.unit_box import UnitBox
from miho.optim import Optimizer, Oracle
from miho.quantities import Array
from miho.validate import at_least, one_of, positive, whole, whole_settings

STRATA = 5
"""Diverse points in addition to the uniform points; the k-th is in the k-th fifth of all ranges
(MEIGO)."""
SAME = 0.01
"""A local solution within this share of the range of an earlier one, in all coordinates, is not
new."""


@dataclass(frozen=True)
class ScatterSearch(Optimizer):
    """eSS of Egea, Balsa-Canto, García and Banga (2009), as in MEIGO.

    A reference set is selected from diverse points: half of it the best, half of it at random. In
    each iteration every member makes a child with every other, drawn from a rectangle that is
    biased towards the better of the two (Sec. 3.2). The best child of a member, if better than the
    member, continues in its direction as long as that helps (go-beyond, Sec. 3.4) and replaces the
    member.

    A local search starts after `first` iterations from the best member, then every `between`
    iterations from the child with the best combination of ranks by loss and by distance to earlier
    starts and solutions. Its solution replaces the child's parent if it is better and new. The
    local search is the solver of `LeastSquares`; AMIGO uses NL2SOL for least squares.

    The search is over the search coordinates scaled to the unit box, at whose bounds rectangles are
    cut, until the budget ends. The first diverse point is the first common initial configuration.
    Requires a least-squares problem.

    Parameters
    ----------
    diverse : int
        Diverse points per parameter.
    members : int, optional
        Size b of the reference set; by default the smallest even b with b^2 - b >= 10 d.
    first, between : int
        Iterations before the first local search, and between two local searches.
    balance : float
        Weight of the distance in the choice of a child, from 0 (only loss) to 1 (only distance).
    patience : int
        Iterations without a better child after which a member is replaced by a uniform draw.
    twins : float
        A member within this share of the range of a better one, in all coordinates, is replaced by
        a uniform draw.
    tolerance, method
        See `LeastSquares`.

    Raises
    ------
    ValueError
        If a setting is out of its range.

    References
    ----------
    J. A. Egea, E. Balsa-Canto, M. G. García and J. R. Banga, Ind. Eng. Chem. Res. 48, 2009.
    """

    loads = ("scipy.optimize",)
    diverse: int = 10
    members: int | None = None
    first: int = 1
    between: int = 10
    balance: float = 0.5
    patience: int = 20
    twins: float = 1e-3
    tolerance: float = 1e-10
    method: str = "trf"

    def __post_init__(self) -> None:
        whole("diverse", self.diverse, 1)
        whole("members", self.members, 3, 10_000, none=True)
        whole_settings(self, ("first", "between", "patience"), 1)
        at_least("balance", self.balance, 0)
        if self.balance > 1:
            raise ValueError(f"balance is {self.balance!r}; expected at most 1")
        positive("twins", self.twins)
        at_least("tolerance", self.tolerance, SMALLEST_TOLERANCE)
        one_of("method", self.method, METHODS)

    def size(self, d: int) -> int:
        """Members of the reference set for d parameters."""
        if self.members is not None:
            return self.members
        least = math.ceil((1 + math.sqrt(1 + 40 * d)) / 2)
        return least + least % 2

    def run(self, oracle: Oracle, rng: np.random.Generator) -> None:
        """Combine, go beyond and search locally until the budget ends."""
        members = _ReferenceSet(oracle, rng, self.size(len(oracle.space)), self.diverse)
        starts: list[Array] = []
        solutions: list[Array] = []
        waited = 0
        while True:
            members.replace_twins(self.twins)
            children, losses = members.combine()
            members.update(children, losses, self.patience)
            waited += 1
            if waited < (self.between if starts else self.first):
                continue
            waited = 0
            if starts:
                parent, child = self.choice(children, losses, starts + solutions)
                start = children[parent, child]
            else:
                parent = int(np.argmin(members.losses))
                start = members.x[parent].copy()
            lowest = local_search(oracle, members.box.theta(start), self.tolerance, self.method)
            starts.append(start)
            solution = members.box.x(lowest.theta)
            new = all(np.abs(solution - earlier).max() > SAME for earlier in solutions)
            if new and math.isfinite(lowest.loss):
                solutions.append(solution)
                if lowest.loss < members.losses[parent]:
                    members.replace(parent, solution, lowest.loss)

    def choice(self, children: Array, losses: Array, searched: list[Array]) -> tuple[int, int]:
        """Parent and number of the child that starts a search, of children (b, b - 1, d).

        The choice depends on the ranks of the losses (b, b - 1) and of the distances to the points
        `searched` before.
        """
        d = children.shape[-1]
        apart = np.linalg.norm(children.reshape(-1, 1, d) - np.array(searched), axis=2).min(axis=1)
        quality, diversity = np.empty(losses.size), np.empty(losses.size)
        quality[np.argsort(losses.ravel(), kind="stable")] = np.arange(losses.size)
        diversity[np.argsort(-apart, kind="stable")] = np.arange(losses.size)
        chosen = int(np.argmin((1 - self.balance) * quality + self.balance * diversity))
        return chosen // losses.shape[1], chosen % losses.shape[1]


class _ReferenceSet:
    """Members x (b, d) in the unit box with their `losses` (b,), the best first after sorting.

    `stuck` (b,) counts the iterations since a member had a better child.
    """

    def __init__(self, oracle: Oracle, rng: np.random.Generator, b: int, diverse: int) -> None:
        self._oracle, self._rng = oracle, rng
        self.box = UnitBox(oracle.space)
        d = len(oracle.space)
        strata = (np.arange(STRATA)[:, None] + rng.random((STRATA, d))) / STRATA
        x = np.concatenate((np.empty((1, d)), strata, rng.random((max(diverse * d, b), d))))
        thetas = self.box.theta(x[1:])
        common = oracle.space.decode(oracle.space.initial(1))
        x[0] = self.box.x(common)[0]
        losses = oracle(np.concatenate((common, thetas)))
        order = np.argsort(losses, kind="stable")
        best = -(-b // 2)
        members = np.concatenate((order[:best], rng.permutation(order[best:])[: b - best]))
        self.x, self.losses = x[members], losses[members]
        self.stuck = np.zeros(b, np.int64)

    def replace(self, i: int, x: Array, loss: float) -> None:
        """Replace the i-th member."""
        self.x[i], self.losses[i], self.stuck[i] = x, loss, 0

    def replace_twins(self, twins: float) -> None:
        """Sort, and replace members within `twins` of better ones, until there are none."""
        while True:
            order = np.argsort(self.losses, kind="stable")
            self.x, self.losses, self.stuck = self.x[order], self.losses[order], self.stuck[order]
            apart = np.abs(self.x[:, None] - self.x).max(axis=2)
            worse = np.nonzero(np.triu(apart <= twins, k=1))[1]
            if not worse.size:
                return
            self._renew(int(worse.max()))

    def combine(self) -> tuple[Array, Array]:
        """Children (b, b - 1, d) of each member with each other, and their losses (b, b - 1)."""
        low, high = rectangles(self.x)
        children = low + (high - low) * self._rng.random(low.shape)
        losses = self._oracle(self.box.theta(children.reshape(-1, low.shape[-1])))
        return children, losses.reshape(low.shape[:2])

    def update(self, children: Array, losses: Array, patience: int) -> None:
        """Replace members by better children, or by uniform draws after `patience`."""
        for i, best in enumerate(np.argmin(losses, axis=1)):
            if losses[i, best] < self.losses[i]:
                self.replace(i, *self._beyond(i, children[i, best], float(losses[i, best])))
            else:
                self.stuck[i] += 1
                if self.stuck[i] >= patience:
                    self._renew(i)

    def _renew(self, i: int) -> None:
        x = self._rng.random(self.x.shape[1])
        self.replace(i, x, self._look(x))

    def _look(self, x: Array) -> float:
        return float(self._oracle(self.box.theta(x)[None])[0])

    def _beyond(self, i: int, child: Array, loss: float) -> tuple[Array, float]:
        """The last improvement on a child better than its parent, the i-th (Algorithm 1)."""
        parent, parent_loss = self.x[i], float(self.losses[i])
        reach, improvements = 1.0, 1
        best, least = child, loss
        while loss < parent_loss:
            best, least = child, loss
            corner = np.clip(child + reach * (child - parent), 0.0, 1.0)
            draw = child + (corner - child) * self._rng.random(child.size)
            parent, parent_loss = child, loss
            child, loss = draw, self._look(draw)
            improvements += 1
            if improvements == 2:
                reach, improvements = 2 * reach, 0
        return best, least


def rectangles(x: Array) -> tuple[Array, Array]:
    """Corners (b, b - 1, d) between which children of the i-th of x (b, d), best first, are drawn.

    c1 = x_i - D (1 + alpha beta) and c2 = x_i + D (1 - alpha beta) with D = (x_j - x_i) / 2, alpha
    = 1 if i is the better, else -1, and beta = (|j - i| - 1) / (b - 2), cut at the box.
    """
    b = len(x)
    i = np.arange(b)[:, None]
    j = np.array([[k for k in range(b) if k != member] for member in range(b)])
    half = (x[j] - x[i]) / 2
    bias = (np.sign(j - i) * (np.abs(j - i) - 1) / (b - 2))[:, :, None]
    low, high = x[i] - half * (1 + bias), x[i] + half * (1 - bias)
    return np.clip(low, 0.0, 1.0), np.clip(high, 0.0, 1.0)
