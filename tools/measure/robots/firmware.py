"""What the firmware of an Uno does when its host dies, when noise strikes its line, and in a platoon: in simavr.

    python -m tools.measure.robots.firmware deaths [--tries 100]
    python -m tools.measure.robots.firmware noise [--hours 1] [--share 0.01]
    python -m tools.measure.robots.firmware latency [--commands 2000]
    python -m tools.measure.robots.firmware resets [--tries 100]
    robofleet run configs/firmware.yaml --lockstep --set robots.0.driver=tools.measure.robots.firmware:LockstepUno ...

The binary is the one that is flashed (drivers/firmware). Its driver is the real one, behind a pseudo-terminal.
"""
