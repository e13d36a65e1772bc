"""R12: the A/A test under load."""

from experiments.faults.timing import cores_of_products


def test_a_pinned_library_uses_one_core() -> None:
    assert cores_of_products() < 1.1
