"""Frames of a film that are decoded from whole data alone: what is damaged or missing spoils all up to the next key frame.

Decoders paint over what they cannot read and go on from there: they mark the painted frame, not those that are built on it.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from .clock import HOLD
from .notes import Note

INTRA = 1
"""Type of a picture that is built on no other; key frames may be such as only begin to renew the picture."""
MARKING = {"h264", "mpeg1video", "mpeg2video", "mpeg4"}
"""Decoders that mark a picture of which a part is missing, so that the last one before a loss is known to be whole."""
AFTER_LOSS = 2
"""Packets from the one that a transport stream marks to the first after the loss: its parser is one behind."""


class Numbered(NamedTuple):
    """A decoded frame and its place among all frames of the film in order of presentation."""

    frame: Any
    number: int


class UndamagedFrames:
    """The undamaged frames that `decoder` makes of the packets of a stream; notes what is left out.

    Packets count from 0 in the order in which they are decoded, and each decoded frame carries the number of its packet. A
    frame is spoilt where a packet from its key frame to itself is damaged. A leading picture, shown before its key frame, is
    built on the group before as well.
    """

    def __init__(self, container: Any, stream: Any, decoder: Any, notes: list[Note]) -> None:
        self.container, self.stream, self.decoder, self.notes = container, stream, decoder, notes
        self.keys: list[int] = []
        """Packets of key frames."""
        self.key_stamps: list[int | None] = []
        """When they are shown."""
        self.damaged: list[int] = []
        """Damaged packets; those without a frame of their own count, too."""
        self.open: set[int] = set()
        """Packets in the decoder."""
        self.held: deque[tuple[int, Any]] = deque()
        """Frames in order of presentation that a packet in the decoder may spoil."""
        self.entered = False
        """The decoder has found its way in: a film may begin in the middle of another one."""
        self.end = 0.0
        """Seconds until which a whole packet is shown."""
        self.error = ""
        """The first of the decoder."""
        self.lost_before: int | None = None
        """Packet before which some were lost in transmission."""
        self.count = 0

    def __iter__(self) -> Iterator[Numbered]:
        """Yield the frames; raises FFmpegError where the container ends too early."""
        for serial, packet in enumerate(self.container.demux(self.stream)):
            if packet.size and packet.is_keyframe:
                self.keys.append(serial)
                self.key_stamps.append(packet.pts)
            elif serial == self.lost_before:
                self.damaged.append(serial - (self.decoder.name not in MARKING))
            if self.keys:  # before a key frame decoders begin with grey pictures
                self._decode(serial, packet)
                yield from self._released(serial)
        yield from self._released(None)

    def _decode(self, serial: int, packet: Any) -> None:
        import av

        packet.opaque = (serial,)  # an object of its own: PyAV finds it by its address
        if packet.size:
            self.open.add(serial)
        if packet.pts is not None and not packet.is_corrupt:
            self.end = max(self.end, float((packet.pts + packet.duration) * packet.time_base))
        try:
            for frame in self.decoder.decode(packet):
                self._hold(frame, serial if frame.opaque is None else frame.opaque[0])
        except av.FFmpegError as error:  # of one of the packets in the decoder: threads tell later
            self.error = self.error or str(error.strerror)
            self.damaged.append(min((one for one in self.open if one > serial - HOLD), default=serial))
            self._leave_out(np.nan)
        if packet.is_corrupt:
            self.lost_before = serial + AFTER_LOSS

    def _hold(self, frame: Any, serial: int) -> None:
        self.open.discard(serial)
        if not frame.is_corrupt:
            self.entered = True
        elif self.entered or (frame.pict_type == INTRA and serial in self.keys):
            self.damaged.append(serial)
        self.held.append((serial, frame))

    def _released(self, newest: int | None) -> Iterator[Numbered]:
        """The frames that no packet in the decoder can spoil any more, `newest` being the last one; all where it is None."""
        while self.held:
            serial, frame = self.held[0]
            waits = any(newest - HOLD < one < serial for one in self.open) if newest is not None else False
            if waits and len(self.held) <= HOLD:
                return
            self.held.popleft()
            if frame.is_corrupt or self._spoilt(serial, frame.pts):
                self._leave_out(np.nan if frame.time is None else frame.time)
            else:
                yield Numbered(frame, self.count)
                self.count += 1

    def _spoilt(self, serial: int, stamp: int | None) -> bool:
        group = bisect_right(self.keys, serial) - 1
        key_stamp = self.key_stamps[group]
        leading = group > 0 and stamp is not None and key_stamp is not None and stamp < key_stamp
        first = self.keys[group - 1 if leading else group]
        return any(first <= one <= serial for one in self.damaged)

    def _leave_out(self, seconds: float) -> None:
        self.notes.append(Note("damaged", self.count, seconds))
        self.count += 1
