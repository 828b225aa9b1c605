"""The built-in scenery: a village edge with two roads, a viaduct, houses, a car park, fields and trees."""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from sim.world import Bridge, ColorBgr, House, Motion, Mover, Plot, Road, Scenery, Surface, Tree

MAIN_ROAD = Road(is_northward=True, offset_m=0.0, width_m=7.4)
CROSS_ROAD = Road(is_northward=False, offset_m=34.0, width_m=7.0)
VIADUCT = Bridge(north_m=-37.0, width_m=6.0, underside_m=5.2, thickness_m=1.1, like_north_m=CROSS_ROAD.offset_m)

CAR_COLORS_BGR: tuple[ColorBgr, ...] = (
    (168, 170, 170), (62, 58, 55), (196, 200, 200), (40, 38, 36), (120, 84, 58),
    (46, 42, 124), (128, 126, 120), (92, 98, 88), (150, 160, 170), (70, 60, 48),
)  # fmt: skip
WALLS_BGR: tuple[ColorBgr, ...] = ((188, 206, 214), (170, 190, 200), (150, 172, 190), (196, 204, 204))
ROOFS_BGR: tuple[ColorBgr, ...] = ((66, 78, 122), (58, 66, 98), (82, 80, 82), (70, 88, 132))

# Trees whose crowns hang between a camera in the south and the lane at east 1.8.
ROADSIDE_TREES = (
    Tree((-68.5, -5.6), 6.6, 4.1, 0),
    Tree((-60.5, -5.4), 6.4, 3.8, 2),
    Tree((14.0, -7.4), 5.0, 3.4, 1),
)


@cache
def village(seed: int) -> Scenery:
    """The tile of the built-in flights; `seed` scatters its trees, parked cars and colours."""
    rng = np.random.default_rng((seed, 1))

    def pick(colors: tuple[ColorBgr, ...]) -> ColorBgr:
        return colors[int(rng.integers(len(colors)))]

    plots = (
        Plot((-108.0, -62.0), 96.0, 86.0, 0.05, Surface.WHEAT),
        Plot((-106.0, 70.0), 100.0, 92.0, -0.09, Surface.GREEN_CROP),
        Plot((105.0, 88.0), 110.0, 100.0, 0.3, Surface.GREEN_CROP),
        Plot((112.0, -78.0), 92.0, 110.0, 1.4, Surface.WHEAT),
        Plot((-4.0, 31.0), 44.0, 36.0, 0.0, Surface.PARKING),
        Plot((-4.0, 10.0), 6.0, 8.0, 0.0, Surface.PARKING),
        Plot((60.0, 24.0), 26.0, 30.0, 0.0, Surface.PAVING),
        Plot((6.0, -118.0), 64.0, 50.0, 0.06, Surface.MEADOW),
        Plot((6.0, 116.0), 60.0, 62.0, -0.04, Surface.MEADOW),
        Plot((8.0, -21.0), 3.0, 34.0, 0.0, Surface.GRAVEL),
        Plot((-14.0, -21.0), 3.0, 34.0, 0.0, Surface.GRAVEL),
    )

    houses = []
    for north_m, east_m, turned in (
        (20.0, -17.0, False), (19.0, -38.0, True), (1.0, -27.0, True), (-8.0, -43.0, False),
        (16.0, -60.0, False), (-14.5, -60.0, True), (49.0, -18.0, True), (50.0, -40.0, False),
        (66.0, -22.0, False), (50.0, -64.0, True), (63.0, 42.0, False), (50.0, 62.0, True),
        (20.0, 64.0, False), (2.0, 68.0, True), (20.0, 88.0, True), (50.0, 90.0, False),
        (-10.0, 92.0, False), (70.0, 12.5, True),
    ):  # fmt: skip
        length_m, width_m = rng.uniform(10.0, 15.0), rng.uniform(7.5, 9.5)
        eaves_m = float(rng.choice([3.0, 3.2, 5.6]))
        yaw_rad = (math.pi / 2 if turned else 0.0) + rng.normal(0, 0.05)
        ridge_m = eaves_m + rng.uniform(2.0, 3.2)
        houses.append(
            House(
                (north_m, east_m), yaw_rad, length_m, width_m, eaves_m, ridge_m, pick(WALLS_BGR), pick(ROOFS_BGR)
            )
        )  # fmt: skip

    parked = []
    for row_east_m in (17.0, 27.5, 33.0, 45.5):
        for north_m in np.arange(-24.0, 17.0, 2.6):
            if rng.random() < 0.5:
                yaw_rad = math.pi / 2 + math.pi * rng.integers(2) + rng.normal(0, 0.03)
                parked.append(Mover(Motion((north_m, row_east_m + rng.normal(0, 0.2)), yaw_rad), pick(CAR_COLORS_BGR)))
    for north_m, east_m in ((9.0, -16.0), (-13.0, -24.0), (8.5, -30.0), (58.0, 20.0), (61.0, 29.0)):
        parked.append(Mover(Motion((north_m, east_m), rng.uniform(0, math.tau)), pick(CAR_COLORS_BGR)))

    treeless = Scenery(
        seed,
        roads=(MAIN_ROAD, CROSS_ROAD),
        plots=plots,
        houses=tuple(houses),
        bridges=(VIADUCT,),
        parked=tuple(parked),
    )
    return replace(treeless, trees=ROADSIDE_TREES + _scattered_trees(treeless, rng))


def _scattered_trees(scenery: Scenery, rng: np.random.Generator) -> tuple[Tree, ...]:
    """Gardens, an avenue on the far side of the main road, and hedgerows; clear of what must stay visible."""
    places = [(n + rng.normal(0, 1.0), 9.8 + rng.normal(0, 0.4)) for n in range(-116, -62, 11)]
    places += [(n + rng.normal(0, 1.2), 8.8 + rng.normal(0, 0.3)) for n in range(52, 120, 12)]
    places += [(-60.0 + rng.normal(0, 1.5), e + rng.normal(0, 1.5)) for e in range(-115, -25, 8)]
    places += [(-57.0 + rng.normal(0, 1.2), e + rng.normal(0, 1.5)) for e in range(22, 118, 9)]
    places += [(rng.uniform(-24, 76), rng.uniform(-84, -13)) for _ in range(120)]
    places += [(rng.uniform(-26, 76), rng.uniform(52, 108)) for _ in range(80)]
    places += [(rng.uniform(-120, 120), rng.uniform(-120, 120)) for _ in range(34)]
    trees: list[Tree] = []
    for north_m, east_m in places:
        radius_m = float(np.clip(rng.normal(2.5, 0.8), 1.2, 4.2))
        tree = Tree((north_m, east_m), 0.5 + 1.25 * radius_m, radius_m, int(rng.integers(6)))
        is_clear = _is_clear(scenery, tree) and all(
            math.dist(tree.pos_ne_m, other.pos_ne_m) > 0.8 * (radius_m + other.crown_radius_m) for other in trees
        )
        if is_clear:
            trees.append(tree)
    return tuple(trees)


def _is_clear(scenery: Scenery, tree: Tree) -> bool:
    """Whether `tree` stands off roads, bridges, houses and the surfaces where nothing grows."""
    (north_m, east_m), radius_m = tree.pos_ne_m, tree.crown_radius_m
    for road in scenery.roads:
        off_m = (east_m if road.is_northward else north_m) - road.offset_m
        # Crowns hide the ground behind them: more room on the side from which the cameras look.
        room_m = road.width_m / 2 + 2.0 + (2.2 if off_m < 0 else 0.6) * radius_m
        if abs(off_m) < room_m:
            return False
    if any(abs(north_m - bridge.north_m) < bridge.width_m / 2 + 1 + radius_m for bridge in scenery.bridges):
        return False
    if any(math.dist(tree.pos_ne_m, house.pos_ne_m) < house.length_m / 2 + radius_m for house in scenery.houses):
        return False
    for plot in scenery.plots:
        north, east = north_m - plot.center_ne_m[0], east_m - plot.center_ne_m[1]
        along = abs(north * math.cos(plot.yaw_rad) + east * math.sin(plot.yaw_rad))
        across = abs(east * math.cos(plot.yaw_rad) - north * math.sin(plot.yaw_rad))
        if plot.surface is not Surface.MEADOW and along < plot.length_m / 2 + 1 and across < plot.width_m / 2 + 1:
            return False
    return True
