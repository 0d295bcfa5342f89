"""Videos: pictures by OpenCV, and the subtitles of DJI's drones beside the video or inside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.wording import either
from slam.core.messages import Message, about, warning
from slam.core.progress import Progress
from slam.io.content import HEAD_BYTES
from slam.io.down_looking import MAX_TILT_DEG, axis_tilt_deg, tilt_remark
from slam.io.files import brief, read_bytes, refusal
from slam.io.recordings.recording import COPY_AGAIN, Content, Offer, PictureChannel, Recording
from slam.io.recordings.tables.table import KIND, RULES
from slam.io.recordings.video.cut_short import without_cut_end
from slam.io.recordings.video.gopro_imu import up_in_body
from slam.io.recordings.video.gpmf import TRACK_CODE, GoproTrack, read_gopro
from slam.io.recordings.video.model_lens import ModelLens, lens_of_model
from slam.io.recordings.video.mp4 import START, Mp4Track, read_tracks, read_user_data
from slam.io.recordings.video.pictures import (
    VideoPictures,
    first_size_of,
    packet_times,
    pictures_held_back,
)
from slam.io.recordings.video.subtitle_streams import SUBTITLE_READERS, subtitle_offers, video_camera
from slam.io.recordings.video.subtitles import Subtitles, parse_subtitles
from slam.io.recordings.video.table_beside import coverage, table_beside
from slam.io.text_encoding import decode_text

Array = NDArray[np.float64]

ASSUMED_RATE_HZ = 25.0
"""Picture rate of a file without times; that of FFmpeg's demuxers of bare streams."""
MAX_SUBTITLE_BYTES = 1 << 28
_GOPRO = "GoPro metadata"
_STABILISED_DEG = 1.0
"""A smaller turn of the pictures moves their centre by less than the uncertainty of an assumed lens."""
_RANK_OF_SUBTITLES = len(RULES)
"""A table beside a video is preferred, since a person put it there."""
_SUBTITLE_CODES = ("tx3g", "text")
_LONGEST_CUE_S = 1.0
"""Longest duration of a subtitle: the last one may begin so long before the end of the video."""


@dataclass(frozen=True)
class _Video:
    stamps_s: Array
    size_px: tuple[int, int]
    is_timed: bool
    """Whether the file holds the times of its pictures."""
    subtitles: Subtitles | None
    subtitle_name: str
    held_back: int = 0
    """Number of pictures that the decoder holds back, where the file has the times of packets only."""
    lens: ModelLens | None = None
    gopro: GoproTrack | None = None
    damage: tuple[Message, ...] = ()


def open_recording(path: Path, *subtitles: Path) -> Recording:
    """Open a video, or the subtitles alone. Raises ``InputError`` where nothing can be read.

    ``subtitles``: their file, if it has not the name of the video.
    """
    if path.suffix.lower() == ".srt":
        video = _Video(np.empty(0), (0, 0), True, _from_file(path), path.name)
    else:
        video = _opened(path)
        if subtitles:
            video = replace(video, subtitles=_from_file(subtitles[0]), subtitle_name=subtitles[0].name)
    beside, remarks = table_beside(path, video.stamps_s)
    gopro = video.gopro

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        readings = {
            offer.stream: SUBTITLE_READERS[offer.stream](video.subtitles)
            for offer in chosen
            if offer.stream != "cam0" and video.subtitles is not None and offer.kind == "subtitles"
        }
        if gopro is not None:
            of_camera = {"gps0": gopro.positions, "imu0": gopro.imu}
            taken_of_it = [offer.stream for offer in chosen if offer.kind == _GOPRO]
            readings |= {stream: of_camera[stream] for stream in taken_of_it}
        warnings = (*_coverage(video), *video.damage, *remarks, *_remarks_of_gopro(gopro))
        if beside is not None:
            content = beside.read([offer for offer in chosen if offer.kind == KIND], progress)
            readings |= content.readings
            warnings += content.warnings
        taken = {offer.stream for offer in chosen}
        date = "" if video.subtitles is None else video.subtitles.date
        pictures = _pictures(path, video, "attitude0" in taken) if "cam0" in taken else None
        return Content(readings, pictures, warnings, {"date": date} if date else {})

    return Recording(
        path=path,
        name=path.stem,
        description="a video" if len(video.stamps_s) else "a file of subtitles",
        offers=tuple(_offers(path, video, beside)),
        others=(
            *_unread_subtitles(video),
            *(() if beside is None else beside.others),
            *(() if gopro is None else ((key, _GOPRO, count) for key, count in gopro.others)),
        ),
        read=read,
    )


def _unread_subtitles(video: _Video) -> tuple[tuple[str, str, int], ...]:
    """Return the subtitles as a channel that is left, where none of their fields is known."""
    if video.subtitles is None or not video.subtitles.unknown:
        return ()
    kind = f"subtitles {brief(video.subtitles.unknown, 60)!r}"
    return ((video.subtitle_name, kind, len(video.subtitles.stamps_s)),)


def lasts_as_long(path: Path, subtitles: Path) -> bool:
    """Return whether a video without subtitles lasts as long as some of another name, to the last cue.

    Subtitles count from the beginning of their video, and end with it.
    """
    video, cues_s = _opened(path), _from_file(subtitles).stamps_s
    if video.subtitles is not None or not len(cues_s) or not len(video.stamps_s):
        return False
    ends_s = video.stamps_s[[0, -1]] - cues_s[[0, -1]]
    return bool((np.abs(ends_s) <= _LONGEST_CUE_S).all())


def _remarks_of_gopro(gopro: GoproTrack | None) -> Iterator[Message]:
    """Yield a warning where the camera says that it turned its pictures, or that it does not look down."""
    if gopro is None:
        return
    if aside := _looks_aside(gopro):
        yield aside.named("cam0")
    if gopro.stabilised_deg >= _STABILISED_DEG:
        yield (
            about(
                "cam0",
                f"pictures are stabilised electronically, by up to {gopro.stabilised_deg:.0f} degrees by "
                "the camera's own record (IORI), so the lens differs from picture to picture",
                "record with the stabilisation (HyperSmooth) off",
            )
        )


def _offers(path: Path, video: _Video, beside: Recording | None) -> Iterator[Offer]:
    """Yield the pictures, and the streams of the table, the subtitles and GoPro's metadata."""
    if rows := len(video.stamps_s):
        reading = f"{video.size_px[0]} x {video.size_px[1]} px"
        yield Offer(stream="cam0", channel=path.name, kind="video", rows=rows, reading=reading)
    if beside is not None:
        yield from beside.offers
    if video.subtitles is not None:
        for offer in subtitle_offers(video.subtitles, video.subtitle_name):
            yield replace(offer, rank=_RANK_OF_SUBTITLES)
    if video.gopro is not None:
        yield from _gopro_offers(video.gopro)


def _gopro_offers(gopro: GoproTrack) -> Iterator[Offer]:
    rank = _RANK_OF_SUBTITLES + 1
    if gopro.key:
        rows = len(gopro.positions.stamps_ns)
        yield Offer(stream="gps0", channel=gopro.key, kind=_GOPRO, rows=rows, reading="deg, m", rank=rank)
    if rows := len(gopro.imu.stamps_ns):
        yield Offer(
            stream="imu0",
            channel="GYRO",
            kind=_GOPRO,
            rows=rows,
            reading=f"rad/s, m/s² (with ACCL); camera's axes {gopro.imu_axes} to forward-left-up",
            rank=rank,
            doubt=_doubt_of_imu(gopro),
        )


def _doubt_of_imu(gopro: GoproTrack) -> str:
    """Return the reason not to take an IMU: pictures that turn otherwise, or a camera that looks aside."""
    if gopro.stabilised_deg >= _STABILISED_DEG:
        return "pictures are stabilised, so they turn otherwise than the camera"
    return str(_looks_aside(gopro) or "")


def _looks_aside(gopro: GoproTrack) -> Message | None:
    """Return a remark where gravity shows that the camera does not look down."""
    up = up_in_body(gopro.imu.values[:, 3:])
    tilt_deg = 0.0 if up is None else axis_tilt_deg(-up)
    return tilt_remark(tilt_deg).prefixed("by gravity the camera") if tilt_deg > MAX_TILT_DEG else None


def _opened(path: Path) -> _Video:
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    is_mp4, is_avi = START.match(head) is not None, head.startswith(b"RIFF")
    tracks = read_tracks(path) if is_mp4 else ()
    size_px = first_size_of(path)
    of_pictures = next((track for track in tracks if track.handler == "vide"), None)
    if of_pictures is not None and (len(of_pictures.stamps_s) > 0 or of_pictures.lost > 0):
        shown, damage = of_pictures.stamps_s, _lost_pictures(of_pictures)
    else:
        shown, damage = without_cut_end(path, packet_times(path))
    if not len(shown):
        raise refusal(path, "is a video that is cut short within its first picture", COPY_AGAIN)
    stamps_s = np.unique(shown) - shown.min()
    is_timed = len(stamps_s) > 1 or len(shown) == 1
    if not is_timed:
        stamps_s = np.arange(len(shown)) / ASSUMED_RATE_HZ
    subtitles, name, of_subtitles = _subtitles_of(path, tracks)
    metadata = next((track for track in tracks if track.code == TRACK_CODE), None)
    gopro = None if metadata is None else read_gopro(path, metadata)
    damage += of_subtitles + (() if gopro is None else gopro.damage)
    held_back = pictures_held_back(path, stamps_s) if is_avi else 0
    lens = lens_of_model(read_user_data(path), size_px) if is_mp4 else None
    return _Video(stamps_s, size_px, is_timed, subtitles, name, held_back, lens, gopro, damage)


def _lost_pictures(track: Mp4Track) -> tuple[Message, ...]:
    """Return a line where pictures of the index lie beyond the end of the file."""
    line = warning(
        f"the file is cut short: {track.lost} of {len(track.sizes)} pictures of its index lie beyond its end "
        "and are lost",
        COPY_AGAIN,
    )
    return (line,) * bool(track.lost)


def _subtitles_of(
    path: Path, tracks: Sequence[Mp4Track]
) -> tuple[Subtitles | None, str, tuple[Message, ...]]:
    """Return the subtitles beside a video, else those inside it; their name, and a line about damage."""
    beside = [p for p in path.parent.iterdir() if p.stem == path.stem and p.suffix.lower() == ".srt"]
    if beside:
        return _from_file(beside[0]), beside[0].name, ()
    track = next((t for t in tracks if t.code in _SUBTITLE_CODES), None)
    if track is None:
        return None, "", ()
    subtitles, lost = subtitles_of_track(path, track)
    lead_out = either(lost, "leads out of the file and is", "lead out of the file and are")
    line = warning(f"{lost} of {len(track.sizes)} subtitles {lead_out} lost", COPY_AGAIN)
    return subtitles, f"{path.name} {track.code}", (line,) * bool(lost)


def _from_file(path: Path) -> Subtitles:
    content = read_bytes(path, path.parent, MAX_SUBTITLE_BYTES)
    return parse_subtitles(decode_text(content)[0])


def subtitles_of_track(path: Path, track: Mp4Track) -> tuple[Subtitles, int]:
    """Return the subtitles of a track of text; each sample is its length in 16 bits, and the text.

    The second value is the number of samples that cannot be read.
    """
    starts = np.concatenate([[0], np.cumsum(track.durations_s)])
    cues, lost = [], 0
    with path.open("rb") as file:
        for k, sample in enumerate(track.samples(file)):
            if sample is None:
                lost += 1
                continue
            text = decode_text(sample[2 : 2 + int.from_bytes(sample[:2], "big")])[0]
            ms = round(float(starts[k]) * 1000)
            clock = f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d},{ms % 1000:03d}"
            cues.append(f"{k + 1}\n{clock} --> {clock}\n{text}\n")
    return parse_subtitles("\n".join(cues)), lost


def _coverage(video: _Video) -> tuple[Message, ...]:
    """Return a warning where the subtitles are empty, or begin late or end early."""
    if video.subtitles is None or not len(video.stamps_s):
        return ()
    if not len(video.subtitles.stamps_s):
        return (
            warning(
                f"{video.subtitle_name} holds no subtitle",
                "switch subtitles on in the camera to have positions",
            ),
        )
    if video.subtitles.unknown:
        first = brief(video.subtitles.unknown, 120)
        return (
            warning(
                f"{video.subtitle_name} has no field that is read, first {first!r}",
                "docs/recordings.md lists them, or give the readings as a table",
            ),
        )
    return coverage(video.subtitle_name, video.subtitles.stamps_s, float(video.stamps_s[-1]))


def _pictures(path: Path, video: _Video, has_angles: bool) -> PictureChannel:
    camera, notes = video_camera(video.size_px, video.subtitles, has_angles, video.lens)
    if not video.is_timed:
        notes.append(warning(f"the file has no times: {ASSUMED_RATE_HZ:g} pictures a second assumed"))
    stamps_ns = np.round(video.stamps_s * 1e9).astype(np.int64)
    return PictureChannel(
        stamps_ns=stamps_ns,
        names=tuple(f"{k:06d}.jpg" for k in range(len(stamps_ns))),
        fetch=VideoPictures(path, video.stamps_s, video.is_timed, video.held_back),
        camera=camera,
        picture_format="jpg",
        notes=tuple(notes),
    )
