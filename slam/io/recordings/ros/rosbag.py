"""ROS 1 and ROS 2 bags (bag, sqlite3, MCAP), read by ``rosbags``; no ROS is needed.

Stamps are those of the messages' headers. A message without a header, or with a stamp of zero, has the time
at which it was recorded.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.wording import either
from frontend.camera import Camera
from slam.core.messages import Message, parsed, warning
from slam.core.progress import Progress
from slam.io.down_looking import MAX_TILT_DEG, Look, axis_tilt_deg
from slam.io.files import brief, refusal
from slam.io.recordings.readers import damage_reported
from slam.io.recordings.recording import (
    COPY_AGAIN,
    Burst,
    Content,
    Offer,
    PictureChannel,
    Recording,
    StreamReadings,
)
from slam.io.recordings.ros import camera as ros_camera
from slam.io.recordings.ros.bag_file import DESCRIPTION, Bag
from slam.io.recordings.ros.bursts import LONGEST_TRANSPORT_S, BodyChannel, bursts_of
from slam.io.recordings.ros.companions import (
    Companion,
    companion_of,
    doubt_of,
    gives_values,
    is_indirect,
)
from slam.io.recordings.ros.messages import (
    CAMERA_INFO,
    IMAGE_KINDS,
    RANGE_KINDS,
    RANGE_T_SONAR,
    TRANSFORM_KINDS,
    RosRule,
)
from slam.io.recordings.ros.open_bag import BagPictures, OpenBag
from slam.io.recordings.ros.rules import RULES
from slam.io.recordings.ros.series import TopicSeries
from slam.io.recordings.ros.transforms import mount_entry
from slam.io.recordings.schedule import CHAIN, GLANCE
from slam.io.sensor_yaml import Value

Array = NDArray[np.float64]
RosMessage = Any

_PROGRESS_STEP = 500
_TF = "/tf_static"


def open_recording(path: Path, *later: Path) -> Recording:
    """Open a bag, or the parts of one. Raises ``InputError`` without ``rosbags``, or for a damaged file."""
    return recording_of(Bag(path, *later), DESCRIPTION)


def recording_of(bag: OpenBag, description: str) -> Recording:
    """Return the recording of an open bag."""
    with damage_reported(bag.path, description):
        offers = [*_camera_offers(bag), *_series_offers(bag)]
    used = {offer.channel for offer in offers}
    used |= {topic for topic, _, _ in bag.topics(CAMERA_INFO, *(TRANSFORM_KINDS if bag.body else ()))}
    others = [each for each in bag.topics() if each[0] not in used]

    def read(chosen: Sequence[Offer], progress: Progress) -> Content:
        with damage_reported(bag.path, description):
            return _read(bag, chosen, progress)

    def watch(offer: Offer, alone: bool) -> tuple[Camera, Iterator[Burst]] | None:
        topic = offer.channel
        with damage_reported(bag.path, description):
            camera, _ = _camera(bag, topic, bag.first[topic], None)
            body = None if alone else _body_channel(bag, offers)
        return None if camera is None else (camera, bursts_of(bag, topic, body, CHAIN if alone else GLANCE))

    return Recording(
        path=bag.path,
        name=bag.path.stem,
        description=description,
        offers=tuple(offers),
        others=tuple(sorted(others)),
        unread={
            topic: why
            for topic, kind, _ in others
            if (why := ros_camera.why_unread(kind.split(" ")[0], bag.first.get(topic)))
        },
        read=read,
        watch=watch,
    )


def _body_channel(bag: OpenBag, offers: Sequence[Offer]) -> BodyChannel | None:
    """Return the topic that shows best how the vehicle turns: a gyro with accelerometer, else an attitude."""
    able = [o for o in offers if o.stream in ("imu0", "attitude0") and o.rows and not o.doubt]
    for offer in sorted(able, key=lambda offer: (offer.stream != "imu0", offer.rank)):
        if companion_of(bag, _rule(offer), offer.channel) is not None:
            continue
        channel = BodyChannel(offer.channel, _rule(offer), bag.mount_of(offer.channel))
        if channel.has_values(bag.first_message(offer.channel)):
            return channel
    return None


def _camera_offers(bag: OpenBag) -> Iterator[Offer]:
    """Yield the topics with pictures; those with a lens, and uncompressed ones, are preferred.

    Without a transform, the name of a camera says where it looks.
    """
    for topic, kind, rows in bag.topics(*IMAGE_KINDS):
        first = bag.first.get(topic)
        if first is None or not ros_camera.is_picture(first, topic):
            continue
        b_T_c = bag.mount_of(topic)
        look, mount = Look.of(topic, bag.frame_of(topic)), ""
        if b_T_c is not None:
            tilt = axis_tilt_deg(b_T_c[:3, 2])
            look = Look.ASIDE if tilt > MAX_TILT_DEG else Look.DOWN
            mount = f", {tilt:.0f} degrees from straight down by {_TF}"
        encoding = getattr(first, "encoding", None) or first.format
        yield Offer(
            stream="cam0",
            channel=topic,
            kind=kind,
            rows=rows,
            reading=f"{brief(encoding, 40)}{mount}",
            rank=len(IMAGE_KINDS) * (bag.camera_info(topic) is None) + IMAGE_KINDS.index(kind),
            is_indirect=ros_camera.tells_samples_only(first),
            look=look,
            is_declared=b_T_c is not None,
            device=ros_camera.device_of(topic),
        )


def _series_offers(bag: OpenBag) -> Iterator[Offer]:
    for rank, rule in enumerate(RULES):
        for topic, _, rows in bag.topics(rule.kind):
            if not gives_values(bag, rule, topic):
                continue
            companion = companion_of(bag, rule, topic)
            yield Offer(
                stream=rule.stream,
                channel=topic,
                kind=rule.kind,
                rows=rows,
                reading=rule.reading if companion is None else f"{rule.reading}, {companion.sentence}",
                rank=rank,
                is_indirect=is_indirect(bag, rule, topic),
                doubt=doubt_of(bag, rule, topic),
            )


def _read(bag: OpenBag, chosen: Sequence[Offer], progress: Progress) -> Content:
    """Read all chosen topics, and those that they are read with, in one pass."""
    attitude = next(((each.channel, _rule(each)) for each in chosen if each.stream == "attitude0"), None)
    companions = {
        offer.stream: companion
        for offer in chosen
        if offer.stream != "cam0" and (companion := companion_of(bag, _rule(offer), offer.channel, attitude))
    }
    series = {offer.stream: TopicSeries(None if offer.stream == "cam0" else _rule(offer)) for offer in chosen}
    series |= {companion.topic: TopicSeries(companion.rule) for companion in companions.values()}
    by_topic = {companion.topic: [series[companion.topic]] for companion in companions.values()}
    for offer in chosen:
        by_topic.setdefault(offer.channel, []).append(series[offer.stream])
    camera = next((offer.channel for offer in chosen if offer.stream == "cam0"), None)
    warnings = [*bag.warnings, *_pass(bag, by_topic, progress), *_one_clock(series)]
    readings = {
        offer.stream: _readings(bag, offer, series, companions.get(offer.stream))
        for offer in chosen
        if offer.stream != "cam0" and len(series[offer.stream].stamps_ns)
    }
    pictures = None
    if camera is not None and len(series["cam0"].stamps_ns):
        pictures, more = _pictures(bag, camera, series["cam0"])
        warnings += more
    return Content(readings, pictures, tuple(warnings))


def _rule(offer: Offer) -> RosRule:
    return RULES[offer.rank]


def _pass(bag: OpenBag, by_topic: dict[str, list[TopicSeries]], progress: Progress) -> list[Message]:
    """Read the messages of some topics; where the bag is damaged, keep what came before."""
    connections = [c for c in bag.connections if c.topic in by_topic]
    total = sum(c.msgcount for c in connections)
    count = 0
    try:
        for connection, recorded_ns, message in bag.messages(connections):
            for each in by_topic[connection.topic]:
                each.add(recorded_ns, message)
            count += 1
            if count % _PROGRESS_STEP == 0:
                progress("reading messages", count, total)
    except Exception as error:  # noqa: BLE001  a reader's errors have no common class
        if not count:
            raise refusal(
                bag.path, f"no message can be read ({brief(error, 160)})", "repair the bag"
            ) from None
        return [
            warning(
                f"the bag is damaged after {count} of {total} messages ({brief(error, 120)})",
                "the rest is lost",
                COPY_AGAIN,
            )
        ]
    progress("reading messages", count, total)
    return (
        [
            warning(
                f"{total - count} of {total} messages {either(total - count, 'is', 'are')} missing in the "
                "bag",
                COPY_AGAIN,
            )
        ]
        if count < total
        else []
    )


def _one_clock(series: dict[str, TopicSeries]) -> list[Message]:
    """Move streams whose headers have another clock than the other ones onto that of the recorder.

    A driver may state the time since the start of its device. Streams of one clock keep their times relative
    to each other.
    """
    late_s = {
        name: float(np.median(np.array(each.recorded_ns) - np.array(each.stamps_ns))) * 1e-9
        for name, each in series.items()
        if len(each.stamps_ns)
    }
    shift_s, warnings = 0.0, list[Message]()
    if not late_s or max(late_s.values()) - min(late_s.values()) <= LONGEST_TRANSPORT_S:
        return []
    previous_s = -np.inf
    for name in sorted(late_s, key=late_s.__getitem__):
        if late_s[name] - previous_s > LONGEST_TRANSPORT_S:
            shift_s = late_s[name] if abs(late_s[name]) > LONGEST_TRANSPORT_S else 0.0
        previous_s = late_s[name]
        if shift_s:
            each = series[name]
            each.stamps_ns = array("q", (np.array(each.stamps_ns) + round(shift_s * 1e9)).tolist())
            warnings.append(
                warning(
                    f"{name}: the clock of its headers is {shift_s:.1f} s behind that of the recorder, "
                    "and is moved onto it",
                    "the delay of the transport remains: set the clocks by one time server",
                )
            )
    return warnings


def _readings(
    bag: OpenBag, offer: Offer, all_series: Mapping[str, TopicSeries], companion: Companion | None
) -> StreamReadings:
    series = all_series[offer.stream]
    rule = series.rule
    assert rule is not None
    stamps_ns, rows = series.table()
    notes: list[Message] = []
    if companion is not None:
        own = all_series[companion.topic].table()
        rows = companion.complete((stamps_ns, rows), own, bag.mount_of(companion.topic))
        if companion.rule.stream == "attitude0" and "attitude0" not in all_series:
            notes.append(warning(f"turned by the yaw of {companion.topic}, which is left out as attitude0"))
    if why := rule.why_missing(rows):
        rows = np.full_like(rows, np.nan)
    mount = bag.mount_of(offer.channel)
    nominal: dict[str, Value] = {}
    notes += [*series.notes(), *rule.remarks(rows)]
    if why:
        notes.append(parsed(why))
    if len(rows):
        nominal |= rule.nominal(rows)
    if rule.is_mounted and mount is not None:
        b_T_s = mount @ RANGE_T_SONAR if rule.kind in RANGE_KINDS else mount
        nominal["T_BS"] = dict(mount_entry(b_T_s))
    elif rule.is_mounted:
        assumed = "looking straight down" if rule.kind in RANGE_KINDS else "body axes"
        frame = brief(bag.frame_of(offer.channel), 40)
        notes.append(
            warning(
                f"no transform of its frame {frame!r} in {_TF}: {assumed} assumed", "record its transform"
            )
        )
    return StreamReadings(stamps_ns, rule.values(rows, mount), nominal, tuple(notes))


def _camera(
    bag: OpenBag, topic: str, first: RosMessage, b_T_c: Array | None
) -> tuple[Camera | None, list[Message]]:
    return ros_camera.camera_of(bag.camera_info(topic), first, b_T_c, ros_camera.is_rectified(topic))


def _pictures(bag: OpenBag, topic: str, series: TopicSeries) -> tuple[PictureChannel | None, list[Message]]:
    camera, notes = _camera(bag, topic, series.first, bag.mount_of(topic))
    if camera is None:
        return None, [line.named(topic).named("cam0") for line in notes]
    suffix = ros_camera.suffix_of_message(series.first)
    connections = [c for c in bag.connections if c.topic == topic]
    fetch = BagPictures(bag, connections, np.array(series.recorded_ns, dtype=np.int64))
    pictures = PictureChannel(
        stamps_ns=np.array(series.stamps_ns, dtype=np.int64),
        names=series.picture_names(suffix),
        fetch=fetch,
        camera=camera,
        notes=(*series.notes(), *notes, *fetch.notes),
    )
    return pictures, []
