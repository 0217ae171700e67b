"""The contract of cameras: a class of checks, to be subclassed with the camera under test."""

from itertools import pairwise
from typing import ClassVar

import pytest

from robofleet.core.clock import Clock, WallClock
from robofleet.tracking.sources import Camera


class CameraContract:
    """Checks for every camera.

    Subclass it in a file of tests::

        class TestMyCamera(CameraContract):
            shape = (720, 1280)

            @pytest.fixture
            def camera(self) -> MyCamera:
                return MyCamera(context)

    Attributes:
        shape: Rows and columns of an image.
        clock: The host's clock, by which the camera says when an image was exposed.
    """

    shape: ClassVar[tuple[int, int]]
    clock: Clock = WallClock()

    @pytest.fixture
    def camera(self) -> Camera:
        """Open the camera.

        Returns:
            The camera, from which four images can be read.

        Raises:
            NotImplementedError: Where a subclass opens none.
        """
        raise NotImplementedError

    def test_images_are_grey_levels_of_its_size(self, camera: Camera) -> None:
        image = camera.read().image
        camera.close()
        assert (image.dtype, image.shape) == ("uint8", self.shape)

    def test_each_image_was_exposed_after_the_last_and_not_in_the_future(self, camera: Camera) -> None:
        instants_ns = []
        for _ in range(3):
            instants_ns.append(camera.read().exposure_ns)
            assert instants_ns[-1] <= self.clock.now_ns()
        camera.close()
        assert all(before < after for before, after in pairwise(instants_ns))

    def test_an_image_stays_as_it_is_while_others_come(self, camera: Camera) -> None:
        image = camera.read().image
        copy = image.copy()
        for _ in range(3):
            camera.read()
        camera.close()
        assert (image == copy).all()

    def test_it_has_an_identity(self, camera: Camera) -> None:
        assert camera.identity
        camera.close()

    def test_it_can_be_closed_twice(self, camera: Camera) -> None:
        camera.read()
        camera.close()
        camera.close()
