"""What is said while kernels are compiled."""

from robofleet.core.compiling import Progress, decoded
from robofleet.core.kernels import Kernel, kernel, reached


@kernel
def inner(x: float) -> float:
    return x + 1.0


@kernel
def outer(x: float) -> float:
    return 2.0 * inner(x)


def test_kernels_are_counted_with_those_that_they_call() -> None:
    assert reached(outer) == {inner, outer}
    assert all(isinstance(kernel, Kernel) for kernel in reached(outer))


def test_progress_crosses_a_lifeline_and_other_words_are_none() -> None:
    progress = Progress("control", 3, 14, 8.0, 0.25)
    assert decoded(progress.encode()) == progress
    assert progress.words() == "compiling the control kernels, once for this installation: 3 of 14, about 8 s left"
    assert decoded("ready") is None
    assert decoded("http://127.0.0.1:8080/#token") is None
