"""How high a camera must hang over an arena, and how large tags look from there: the table of the laboratory's guide.

    python -m tools.measure.calibration.heights     (from the project's root)

The arithmetic is that of `robofleet doctor --plan`. Images are 16:9, lenses without distortion.
"""

from robofleet.doctor.plan import ANGLES_DEG, Wanted, lowest_m, side_px

ARENAS = (2.0, 1.2), (3.2, 2.0), (3.5, 2.3), (5.0, 3.0)


def main() -> None:
    """Print the table: lowest height, and pixels a tag's side at 1280 x 720 and at 1920 x 1080."""
    print("| angle of view |", " | ".join(f"{x:g} x {y:g} m" for x, y in ARENAS), "|")
    print("|---" * (len(ARENAS) + 1) + "|")
    for angle in ANGLES_DEG:
        cells = []
        for arena in ARENAS:
            wanted = Wanted(
                arena_m=arena, robots=1, tag_side_m=0.07, tag_height_m=0.08, body_radius_m=0.055, speed_m_s=0.2,
                image_px=(1280, 720),
            )  # fmt: skip
            height = lowest_m(angle, arena, wanted)
            side = side_px(angle, height, wanted)
            cells.append(f"{height:.1f} m, {side:.0f} / {1.5 * side:.0f} px")
        print(f"| {angle}° |", " | ".join(cells), "|")


if __name__ == "__main__":
    main()
