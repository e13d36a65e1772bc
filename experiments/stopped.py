"""How a signal ends a command."""


class Stopped(KeyboardInterrupt):
    """A signal ended what was going on; `number` is its number."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number
