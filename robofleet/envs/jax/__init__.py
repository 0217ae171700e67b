"""The step of ``envs/arenas.py`` in JAX, for accelerators. The extra ``jax`` brings JAX."""
