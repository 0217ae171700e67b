"""What each robot should do: the Newton-Raphson flow, the path, the platoon. Pure."""
