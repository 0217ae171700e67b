"""Functions that Python runs and numba does not compile: of x and u, and of one vector."""

import numpy as np

MIX = np.array([[1]])
CAR = {"mass": 2.0}


def _inside(v):
    return np.fft.rfft(v).real


def formats(x, u=0.0):
    return x * len(f"{x[0]:.3f}")


def counts_bytes(x, u=0.0):
    return x * len(x.dumps())


def fails_inside(x, u=0.0):
    return _inside(x)


def multiplies_integers(x, u=0.0):
    return MIX @ x


def asks_too_much(x, u=0.0):
    return np.full(1, fill_value=2.0, order="C")


def reads_a_dict(x, u=0.0):
    return x / CAR["mass"]
