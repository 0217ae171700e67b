"""The simulated camera with MuJoCo's pixels (``camera.source: mujoco``)."""

from collections.abc import Iterator

import numpy as np

from robofleet.config import slices
from robofleet.config.faults import Complaint
from robofleet.config.tree import Config
from robofleet.simulation.effects import shade
from robofleet.simulation.mujoco.extra import missing
from robofleet.simulation.mujoco.renderer import Body, MujocoRenderer, no_display
from robofleet.simulation.scene import light_at, lying_prints, true_offset_rows, true_targets
from robofleet.simulation.sources import SimulatedCamera
from robofleet.tracking.camera import CameraGeometry


class MujocoCamera(SimulatedCamera):
    """Times, exposure and troubles of the simulated camera; MuJoCo draws what it sees."""

    @staticmethod
    def refusals(config: Config) -> Iterator[Complaint]:
        yield from SimulatedCamera.refusals(config)
        if why := missing("mujoco", "OpenGL") or no_display():
            yield "camera.source", why
        if config.camera.simulated.prints:
            yield "camera.simulated.prints", "'mujoco' draws exact prints alone: remove them, or take 'simulated'"

    @staticmethod
    def renderer(config: Config, rng: np.random.Generator) -> MujocoRenderer:
        camera, simulated = config.camera, config.camera.simulated
        bodies = zip(true_targets(config), config.seen, strict=True)
        return MujocoRenderer(
            CameraGeometry.from_model(camera.model), (camera.width, camera.height),
            [Body(target, robot.vehicle.body_radius_m) for target, robot in bodies], lying_prints(config),
            slices.world(config).obstacles, true_offset_rows(config), camera.noise_gray, rng,
            exposure_s=camera.exposure_s, light=light_at(simulated, 0.0), lens_sigma_px=simulated.lens_sigma_px,
            shade=shade(simulated, (camera.width, camera.height)),
        )  # fmt: skip
