"""One simulated flight: from the manoeuvre to the streams of its instruments."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam.core.errors import InputError
from slam.core.flight import Flight
from slam.core.streams import Frames, Truth
from slam.simulation import sensors
from slam.simulation.battery import read_battery
from slam.simulation.camera.effects import camera_effects
from slam.simulation.camera.film import Film, film_flight
from slam.simulation.chance import generator
from slam.simulation.manoeuvre import MAX_HEIGHT_M, plan
from slam.simulation.motion import Motion, at_rest, draw_model_noise, simulate_motion, step_count
from slam.simulation.pilot import fly
from slam.simulation.place.terrain import elevation
from slam.simulation.place.world import World, with_place_terms
from slam.simulation.recipe import Recipe
from slam.simulation.script import stick_from
from slam.simulation.terms import CATALOGUE

Array = NDArray[np.float64]

EPOCH_NS = 1_315_785_600_000_000_000
"""Second 0 of every simulated flight, 2011-09-12: a constant, so that the same seed gives the same bytes."""
TRUTH_RATE_HZ = 100.0
PILOT_MARGIN_M = 0.5
"""Distance by which a pilot may leave the floor, in metres; way points must lie on it."""


def record(recipe: Recipe, seed: int) -> Flight:
    """Fly a checked recipe. Raises ``InputError`` where the flight leaves the floor or hits it."""
    model, world = recipe.model, _place(recipe)
    try:
        motion = fly_recipe(recipe, seed)
    except InputError as error:
        raise InputError(f"recipe {recipe.name}: {error}") from None
    film = _film(recipe, world, motion, seed) if recipe.camera is not None else None
    return Flight(
        name=f"{recipe.name}-seed-{seed}",
        epoch_ns=EPOCH_NS,
        camera=None if film is None else film.nominal_camera,
        frames=None if film is None else Frames(film.stamps_s, _names(film.stamps_s), film),
        imu=sensors.read_imu(motion, model, seed),
        sonar=sensors.read_sonar(motion, model, world, seed),
        attitude=sensors.read_attitude(motion, model, seed),
        velocity=sensors.read_velocity(motion, model, world, seed),
        command=sensors.log_command(motion.stick, model),
        battery=read_battery(motion, model, seed),
        truth=_truth(motion),
        landmarks={
            name: np.array([x, y, float(world.ground.height(x, y))])
            for name, (x, y) in recipe.landmarks.items()
        },
        landmark_pairs=recipe.landmark_pairs,
        gaps=recipe.gaps,
        notes={
            "vehicle": f"simulated quadrotor, model {model.name}",
            "source": f"recipe {recipe.name}, seed {seed}",
        },
    )


def fly_recipe(recipe: Recipe, seed: int) -> Motion:
    """Return the true motion of a recipe. Raises ``InputError`` where it leaves or hits the floor."""
    manoeuvre, model = recipe.maneuver, recipe.model
    rngs = (generator(seed, "hold noise"), generator(seed, "gusts"))
    if manoeuvre.script:
        stick = stick_from(manoeuvre)
        start = at_rest(*manoeuvre.start_m, manoeuvre.height_m, float(np.radians(manoeuvre.heading_deg)))
        motion = simulate_motion(
            stick, model, start, draw_model_noise(model, step_count(stick.duration_s), rngs)
        )
        _refuse_beyond(motion, recipe.world, 0.0)
    else:
        path = plan(manoeuvre, recipe.landmarks, recipe.world.extent_m)
        motion = fly(path, model, draw_model_noise(model, step_count(path.duration_s), rngs))
        # Way points may lie on the border, and wind may push the vehicle across it. There is no picture
        # beyond the margin.
        _refuse_beyond(motion, recipe.world, max(recipe.world.margin_m, PILOT_MARGIN_M))
    if not (manoeuvre.script and manoeuvre.may_land):
        x, y, z = motion.states[:, :3].T
        ground_m = elevation(_place(recipe), x, y)
        low = z - ground_m < model.vehicle.gear_height_m
        what = "hits an obstacle" if (ground_m[low] > 0).any() else "hits the floor"
        _refuse_at(motion, low, what, "fly higher, or set may_land for a script that lands")
    return motion


def _refuse_beyond(motion: Motion, world: World, room_m: float) -> None:
    x, y, z = motion.states[:, :3].T
    x0, y0, x1, y1 = world.extent_m
    # Written so that NaN counts as outside too.
    beyond = ~((x >= x0 - room_m) & (x <= x1 + room_m) & (y >= y0 - room_m) & (y <= y1 + room_m))
    _refuse_at(motion, beyond, "leaves the floor", "make world.extent_m larger or the commands smaller")
    _refuse_at(motion, ~(z <= MAX_HEIGHT_M), f"climbs beyond {MAX_HEIGHT_M:g} m", "command less climb")


def _refuse_at(motion: Motion, bad: NDArray[np.bool_], what: str, do: str) -> None:
    if bad.any():
        k = int(np.argmax(bad))
        x, y, _ = motion.states[k, :3]
        at = f"after {k * motion.step_s:.1f} s at ({x:.1f}, {y:.1f})"
        raise InputError(f"maneuver: the vehicle {what} {at}: {do}")


def _place(recipe: Recipe) -> World:
    marks = tuple((name, x, y) for name, (x, y) in recipe.landmarks.items())
    return with_place_terms(recipe.world, marks, recipe.model.terms)


def _film(recipe: Recipe, world: World, motion: Motion, seed: int) -> Film:
    assert recipe.camera is not None
    clock = generator(seed, "camera clock")
    stamps_s = sensors.stamps(recipe.camera.rate_hz, motion.duration_s, clock)
    marks = tuple((name, x, y) for name, (x, y) in recipe.landmarks.items())
    # A parameter that a model leaves out has its neutral value.
    terms = {name: {**CATALOGUE[name].neutral, **values} for name, values in recipe.model.terms.items()}

    def pose_at(times_s: Array) -> Array:
        return motion.at(times_s).w_T_b

    effects = camera_effects(terms)
    return film_flight(world, marks, recipe.camera, effects, stamps_s, pose_at, motion.duration_s, seed)


def _names(stamps_s: Array) -> tuple[str, ...]:
    return tuple(f"{EPOCH_NS + round(stamp * 1e9)}.png" for stamp in stamps_s)


def _truth(motion: Motion) -> Truth:
    """Return the truth over the whole flight, so that every stamp of every stream lies within it."""
    count = int(np.ceil(motion.duration_s * TRUTH_RATE_HZ)) + 1
    state = motion.at(np.round(np.linspace(0.0, motion.duration_s, count), 9))
    return Truth(state.stamps_s, state.w_T_b, state.w_v_m_s)
