"""Frames of a film that are decoded from whole data alone: what is damaged or missing spoils all up to the next key frame.

Decoders paint over what they cannot read and go on from there: they mark the painted frame, not those that are built on it.
"""

from __future__ import annotations

import re
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
"""Decoders that mark most pictures of which a part is missing, if one thread decodes."""
TRACED = {"h264": "pict"}
"""Decoder -> FFmpeg's option `debug`: they mark no missing picture, but their log shows it."""
UNIT = re.compile(r"nal_unit_type: ([15])\(.*?nal_ref_idc: (\d)")
"""Type and reference flag of a slice: 5 restarts the count of references; at 0 no other picture is built on it."""
COUNT = re.compile(r"\bframe:(\d+)")
"""References before a slice, `frame_num` of ITU-T H.264, 7.4.3; begins again at a power of 2 from 16 on."""
MIN_COUNTED = 16
LEAVE_OUT_BY_THEMSELVES = {"hevc"}
"""Decoders that give no frame for a packet that is built on a missing one, and one for every other packet."""
MISSING = "Missing reference picture"
"""Told of a slice whose list of references has a hole."""
BETWEEN = 0.5
"""Packets by which a loss lies before a key frame: it spoils the leading pictures alone."""
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
        """Time stamps at which they are shown."""
        self.damaged: list[float] = []
        """Damaged packets; those without a frame of their own count, too. A half is a loss between two."""
        self.open: dict[int, float] = {}
        """Packets in the decoder, and when they are shown (s; NaN where that is not known)."""
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
        self.reference = -1
        """Count of the last picture that others are built on; -1 before the first."""
        self.count = 0

    def __iter__(self) -> Iterator[Numbered]:
        """Yield the frames; raises FFmpegError where the container ends too early."""
        for serial, packet in enumerate(self.container.demux(self.stream)):
            if packet.size and packet.is_keyframe:
                self.keys.append(serial)
                self.key_stamps.append(packet.pts)
            elif serial == self.lost_before:
                self.damaged.append(serial - 1)  # what is left of the one before may read as a whole picture
            if self.keys:  # before a key frame decoders begin with grey pictures
                self._decode(serial, packet)
                yield from self._released(serial)
        yield from self._released(None)
        if self.decoder.name in LEAVE_OUT_BY_THEMSELVES and self.keys:
            self._note_unshown()

    def _note_unshown(self) -> None:
        """Note the packets that gave no frame, but for leading pictures of a film that begins in the middle of another."""
        stamp = self.key_stamps[0]
        begin = -np.inf if stamp is None else float(stamp * self.stream.time_base)
        for seconds in self.open.values():
            if not seconds < begin:
                self._leave_out(seconds)

    def _decode(self, serial: int, packet: Any) -> None:
        import av

        packet.opaque = (serial,)  # an object of its own: PyAV finds it by its address
        if packet.size and not packet.is_discard:  # what an edit list hides gives no frame
            self.open[serial] = np.nan if packet.pts is None else float(packet.pts * packet.time_base)
        if packet.pts is not None and not packet.is_corrupt:
            self.end = max(self.end, float((packet.pts + packet.duration) * packet.time_base))
        try:
            for frame in self._frames(packet, serial):
                self._hold(frame, serial if frame.opaque is None else frame.opaque[0])
        except av.FFmpegError as error:  # of one of the packets in the decoder: threads tell later
            self.error = self.error or str(error.strerror)
            self.damaged.append(min((one for one in self.open if one > serial - HOLD), default=serial))
            self._leave_out(np.nan)
        if packet.is_corrupt:
            self.lost_before = serial + AFTER_LOSS

    def _frames(self, packet: Any, serial: int) -> list[Any]:
        """Return the frames that come out of the decoder for a packet; looks in FFmpeg's log for a loss before it."""
        from av import logging

        if self.decoder.name not in TRACED:
            return self.decoder.decode(packet)
        level = logging.get_level()
        logging.set_level(logging.DEBUG)
        try:
            with logging.Capture(local=True) as log:
                return self.decoder.decode(packet)
        finally:
            logging.set_level(level)
            if self._lost("\n".join(text for _, _, text in log)):
                key, stamp = self.keys[-1], self.key_stamps[-1]
                leading = packet.pts is not None and stamp is not None and packet.pts < stamp
                self.damaged.append(key - BETWEEN if leading else serial - BETWEEN * (serial == key))

    def _lost(self, log: str) -> bool:
        """Return True where a reference before a picture is missing, by the decoder's log."""
        unit, count = UNIT.search(log), COUNT.search(log)
        if unit is None or count is None:
            return False
        number, before = int(count[1]), self.reference
        if unit[2] != "0":
            self.reference = number
        again = before + 1 >= MIN_COUNTED and (before + 1).bit_count() == 1 and number == 0
        follows = unit[1] == "5" or before < 0 or number - before in (0, 1) or again
        return not follows or MISSING in log

    def _hold(self, frame: Any, serial: int) -> None:
        self.open.pop(serial, None)
        if not frame.is_corrupt:
            self.entered = True
        elif self.entered or (frame.pict_type == INTRA and serial in self.keys):
            self.damaged.append(serial)
        self.held.append((serial, frame))

    def _released(self, newest: int | None) -> Iterator[Numbered]:
        """Yield the frames that no packet in the decoder can spoil any more, `newest` being the last one; all where it is None."""
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
