"""Camera of the blind tests' quadrotor: a floor of clouds and shards, rendered ray by ray.

The simulator warps and filters whole pictures. Here each sample of a pixel has its own ray and, with a
rolling shutter, its own time.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from tests.blind.instruments import Moments, moments
from tests.blind.vehicle import Knobs, Path

RATE_HZ = 4.0
WIDTH, HEIGHT, FOCAL_PX = 176, 144, 140.8
MIDDLE = np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2])
CORNER = float(np.hypot(*MIDDLE)) / FOCAL_PX
NOISE_LEVELS = 2.0
JPEG_QUALITY = 92
B_R_C = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Top of the picture ahead."""
SAMPLES = 2
"""Rays a pixel, along rows and along columns."""
GLIMPSES = 7
"""Number of times sampled in an exposure."""
PIECE_M, PIECES = 0.005, 2400
"""Grain of the floor, and its period."""
LAMP_M = np.array([2.5, 2.5, 2.8])
"""Spacing of the grid of lamps along x and y, and its height."""
GLOSS = 240.0
"""Exponent of the cosine in a lamp's specular lobe (Blinn 1977)."""
TORN_AT = 0.5
"""Share of the rows above which a torn picture is of another time."""
MEAN_LEVEL = 115.0
"""Target level of the automatic exposure."""

Rng = np.random.Generator


@dataclass(frozen=True)
class Mover:
    """A box that slides to and fro between two positions."""

    ends: np.ndarray
    """(2, 2) m."""
    half: np.ndarray
    """(2,) m."""
    seconds: float
    phase: float
    colour: np.ndarray

    def at(self, t: float) -> np.ndarray:
        """(2,) its centre."""
        way = abs((t / self.seconds + self.phase) % 2.0 - 1.0)
        return self.ends[0] + way * (self.ends[1] - self.ends[0])


def floor(rng: Rng) -> np.ndarray:
    """(PIECES, PIECES, 3) levels, endless: the last piece adjoins the first."""
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(PIECES), np.fft.rfftfreq(PIECES), indexing="ij")) * PIECES
    power = 1.0 / (f + 6.0) ** rng.uniform(1.25, 1.5)
    clouds = []
    for _ in range(4):
        phases = np.exp(2j * np.pi * rng.uniform(size=f.shape))
        cloud = np.fft.irfft2(power * phases, s=(PIECES, PIECES))
        clouds.append(cloud / cloud.std())
    light = rng.uniform(95.0, 140.0, 3) + 30.0 * clouds[0][..., None]
    levels = (light + 14.0 * np.stack(clouds[1:], axis=-1)).astype(np.float32)
    for _ in range(round(5 * (PIECE_M * PIECES) ** 2)):
        angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 7)))
        reach = rng.uniform(0.03, 0.18) / PIECE_M
        shape = reach * np.column_stack([np.cos(angles), rng.uniform(0.3, 1.0) * np.sin(angles)])
        turn = rng.uniform(0.0, 2.0 * np.pi)
        c, s = np.cos(turn), np.sin(turn)
        shard = (shape @ np.array([[c, s], [-s, c]]) + rng.uniform(0, PIECES, 2)).astype(np.int32)
        colour = [float(v) for v in np.clip(rng.normal(115.0, 45.0, 3), 20, 235)]
        for dx in (-PIECES, 0, PIECES):
            for dy in (-PIECES, 0, PIECES):
                box = shard + (dx, dy)
                if (box.max(axis=0) >= 0).all() and (box.min(axis=0) < PIECES).all():
                    cv2.fillPoly(levels, [box], colour, cv2.LINE_AA)
    return np.clip(levels, 8.0, 248.0)


def movers(path: Path, member: int, count: int, rng: Rng) -> list[Mover]:
    """Each crosses a place that the vehicle comes by."""
    place = path.state[:, :2, member]
    out = []
    for _ in range(count):
        over = place[rng.integers(len(place))] + rng.normal(0.0, 0.2, 2)
        way = rng.uniform(0.0, np.pi)
        stride = rng.uniform(0.6, 1.4) * np.array([np.cos(way), np.sin(way)])
        ends, half = np.stack([over - stride, over + stride]), rng.uniform(0.18, 0.35, 2)
        seconds = 2.0 * float(np.hypot(*stride)) / rng.uniform(0.15, 0.5)
        out.append(Mover(ends, half, seconds, rng.uniform(0, 2), rng.uniform(20.0, 235.0, 3)))
    return out


@dataclass(frozen=True)
class Camera:
    """One vehicle's camera over its floor."""

    k: Knobs
    ground: np.ndarray
    crowd: list[Mover]

    def rays(self, flown: float) -> np.ndarray:
        """(rows, columns, 3) body directions of all samples, a share ``flown`` into the flight."""
        k = self.k
        side = [
            (np.arange(n * SAMPLES) + 0.5) / SAMPLES - 0.5 - middle
            for n, middle in zip((WIDTH, HEIGHT), MIDDLE, strict=True)
        ]
        seen = np.stack(np.meshgrid(*side), axis=-1) / (FOCAL_PX * (1.0 + k["zoom"] + k["creep"] * flown))
        seen[..., 0] /= 1.0 + k["squeeze"]
        # A drop of water: a lens of its own, off the middle.
        off = seen - (0.25, -0.2)
        near = np.exp(-np.sum(off**2, axis=-1, keepdims=True) / (2.0 * 0.12**2))
        seen = seen - k["drop"] * near * off
        # Division model (Fitzgibbon 2001): what is seen at r came from r / (1 + k r^2).
        bent = seen / (1.0 + k["barrel"] * np.sum(seen**2, axis=-1, keepdims=True))
        out = np.concatenate([bent, np.ones((*bent.shape[:2], 1))], axis=-1) @ B_R_C.T
        turn = Rotation.from_rotvec([k["mount_x"], k["mount_y"], 0.0])
        return out @ turn.as_matrix().T

    def lit(self, m: Moments, rays: np.ndarray) -> np.ndarray:
        """(rows, columns, 3) light that comes along the rays; ``m`` one moment, or one a row."""
        w_r_b = m.w_R_b.as_matrix()
        world = rays @ w_r_b[0].T if len(w_r_b) == 1 else np.einsum("rij,rcj->rci", w_r_b, rays)
        place = m.place[:, None, :]
        hit = place[..., :2] - place[..., 2:] * world[..., :2] / world[..., 2:]
        at = np.mod(hit / PIECE_M, PIECES).astype(np.float32)
        light = cv2.remap(self.ground, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        for mover in self.crowd:
            inside = np.abs(hit - mover.at(float(m.t[0]))) / mover.half
            stripes = 1.0 + 0.25 * np.sign(np.sin(9.0 * inside[..., :1]))
            light = np.where((inside < 1.0).all(axis=-1)[..., None], mover.colour * stripes, light)
        if self.k["shine"] > 0.0:
            lamp = np.append((np.floor(hit.mean(axis=(0, 1)) / LAMP_M[:2]) + 0.5) * LAMP_M[:2], LAMP_M[2])
            ground = np.concatenate([hit, np.zeros((*hit.shape[:2], 1))], axis=-1)
            ways = [end - ground for end in (lamp, np.broadcast_to(place, ground.shape))]
            half = sum(way / np.linalg.norm(way, axis=-1, keepdims=True) for way in ways)
            facing = half[..., 2:] / np.linalg.norm(half, axis=-1, keepdims=True)
            light = light + 255.0 * self.k["shine"] * facing**GLOSS
        return np.asarray(light, dtype=np.float32)

    def exposed(self, path: Path, member: int, t: float) -> np.ndarray:
        """(HEIGHT, WIDTH, 3) light that the sensor gathers."""
        k, end = self.k, path.h * len(path.held)
        rows = np.repeat(np.arange(HEIGHT) / (HEIGHT - 1), SAMPLES)
        late = k["readout"] * rows - k["torn"] * (rows > TORN_AT)
        rays = self.rays(t / end)
        spread = k["open_s"] * (np.arange(GLIMPSES) / (GLIMPSES - 1) - 0.5) if k["open_s"] else np.zeros(1)
        gathered = np.zeros((HEIGHT * SAMPLES, WIDTH * SAMPLES, 3), np.float32)
        for past in spread:
            when = t + past + (late if late.any() else np.zeros(1))
            gathered += self.lit(moments(path, member, np.clip(when, 0.0, end)), rays)
        light = cv2.resize(gathered / len(spread), (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        unsharp = k["hunting"] * np.sin(2.0 * np.pi * t / 5.3) ** 2
        return cv2.GaussianBlur(light, (0, 0), unsharp) if unsharp > 0.2 else light

    def shaded(self, light: np.ndarray, t: float, flown: float, rng: Rng) -> np.ndarray:
        """Return the light behind a lens with vignetting, dirt and haze, under lamps that may flicker."""
        k = self.k
        x, y = np.meshgrid(np.arange(WIDTH) - MIDDLE[0], np.arange(HEIGHT) - MIDDLE[1])
        r2 = (x**2 + y**2) / FOCAL_PX**2
        fall = (1.0 + r2) ** (np.log1p(-k["dark_edge"]) / np.log1p(CORNER**2))
        beat = 1.0 + k["flicker"] * np.sin(2.0 * np.pi * (2.3 * y / HEIGHT + rng.uniform()))
        dirt = 1.0 - k["dirt"] * np.exp(-((x - 31.0) ** 2 + (y + 24.0) ** 2) / (2.0 * 9.0**2))
        light = light * (fall * beat * dirt)[..., None]
        haze = k["haze"] * flown**1.5
        return light * (1.0 - haze) + 170.0 * haze


def pictures(path: Path, member: int, ground: np.ndarray, rng: Rng) -> list[tuple[float, bytes]]:
    """Return stamps in seconds from the beginning, and JPEGs."""
    k = {name: float(value[member]) for name, value in path.knobs.items()}
    camera = Camera(k, ground, movers(path, member, round(k["crowd"]), rng))
    end = path.h * len(path.held)
    rate = RATE_HZ * rng.uniform(0.996, 1.004)
    stamps = rng.uniform(0.0, 0.25) + np.arange(int((end - 0.25) * rate)) / rate
    gains, out, lost = np.ones(3), [], False
    for t in stamps:
        light = camera.exposed(path, member, t - k["stamp_late"])
        light = camera.shaded(light, t, t / end, rng)
        # Each colour is brought to the aim with a lag, and a curve follows the mean gain.
        share = 1.0 - np.exp(-1.0 / (rate * k["adapt_s"]))
        aim = MEAN_LEVEL / np.maximum(light.mean(axis=(0, 1)), 1.0)
        gains = np.exp(np.log(gains) + share * (k["adapt"] * np.log(aim) - np.log(gains)))
        curve = np.exp(0.7 * np.log(gains.mean()))
        levels = 255.0 * (np.clip(light, 0.0, None) / 255.0) ** curve * gains
        levels = levels + NOISE_LEVELS * rng.standard_normal(levels.shape)
        # Where one picture is lost the next one is likelier to be.
        lost = rng.uniform() < (k["lost"] * (3.0 if lost else 0.95))
        if not lost:
            raw = np.clip(np.rint(levels), 0, 255).astype(np.uint8)
            done, jpeg = cv2.imencode(".jpg", raw, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            assert done
            out.append((float(t), jpeg.tobytes()))
    return out
