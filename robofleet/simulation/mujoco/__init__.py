"""A second physics and a second renderer, both MuJoCo's: the extra ``mujoco``, loaded where it is used."""
