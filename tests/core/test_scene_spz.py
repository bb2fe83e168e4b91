"""SPZ against bytes read by hand from the format's text, and there and back within its steps."""

import gzip
import struct

import numpy as np
import pytest
from random_scene import random_scene

from f4x_core.errors import F4xError
from f4x_core.geometry import quaternion
from f4x_core.geometry.splats import Splats
from f4x_core.scene.foreign import open_any
from f4x_core.scene.formats import export
from f4x_core.scene.formats.spz import pack_spz, read_spz
from f4x_core.scene.ply import read_ply
from f4x_core.scene.recognise import identify


def test_the_bytes_are_those_of_the_format():
    # Largest is w, so x, y, z are stored: 0.6 of 1 is 0.6 sqrt(2) 511 = 433.6, negative; the others 0.
    one = Splats(
        means=np.float32([[1, -0.5, 0.25]]),
        quats=np.float32([[0.8, -0.6, 0, 0]]),
        scales=np.exp(np.float32([[-4, -3, -10]])),
        opacities=np.float32([0.6]),
        sh=np.float32([[[0, 1, -9]], [[0.5, 0, 0]], [[0, -0.25, 0]], [[0, 0, 2]]]).reshape(1, 4, 3),
    )
    body = gzip.decompress(pack_spz(one))
    magic, version, count, degree, fraction, flags, reserved = struct.unpack_from("<IIIBBBB", body)
    assert (magic, version, count, degree, flags, reserved) == (0x5053474E, 3, 1, 1, 0, 0)
    position = [int.from_bytes(body[16 + 3 * i : 19 + 3 * i], "little", signed=True) / 2**fraction for i in range(3)]
    assert position == [1, -0.5, 0.25]
    assert list(body[25:32]) == [153, 128, 166, 0, 96, 112, 0]
    packed = struct.unpack_from("<I", body, 32)[0]
    assert (packed >> 30, packed >> 20 & 1023, packed & 0xFFFFF) == (3, 512 + 434, 0)
    assert list(body[36:]) == [192, 128, 128, 128, 96, 128, 128, 128, 255]


def test_there_and_back_within_the_steps(tmp_path):
    scene = random_scene(degree=3)
    export(scene, tmp_path / "a.spz", [2.5], "spz")
    export(scene, tmp_path / "a.ply", [2.5], "ply")
    back, exact = read_spz(tmp_path / "a.spz"), read_ply(tmp_path / "a.ply")
    assert np.abs(back.means - exact.means).max() < 2**-19
    assert np.abs(np.log(back.scales / exact.scales)).max() < 0.51 / 16
    assert np.abs(back.opacities - exact.opacities).max() < 0.51 / 255
    turned = quaternion.multiply(quaternion.conjugate(exact.quats), back.quats)
    assert np.linalg.norm(turned[:, 1:], axis=1).max() < 0.003  # half the angle in radians
    assert np.sqrt(np.mean((back.sh - exact.sh) ** 2)) < 0.04
    assert identify(tmp_path / "a.spz") == "spz" and len(open_any(tmp_path / "a.spz").static) == len(exact)


def test_version_2_is_read(tmp_path):
    # Rotation by 90 degrees about z in the file's axes (z backward) is one about -z in ours.
    z = round(127.5 + 127.5 * np.sqrt(0.5))
    body = struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 12, 0, 0)
    body += b"".join((v & 0xFFFFFF).to_bytes(3, "little") for v in (4096, -8192, 2048))
    body += bytes([255, 128, 128, 128, 160, 160, 160, 128, 128, z])
    path = tmp_path / "two.spz"
    path.write_bytes(gzip.compress(body))
    splats = read_spz(path)
    np.testing.assert_array_equal(splats.means, [[1, 2, -0.5]])
    np.testing.assert_allclose(splats.scales, 1)
    turned = quaternion.rotate(splats.quats, np.float32([[1, 0, 0]]))
    np.testing.assert_allclose(turned, [[0, -1, 0]], atol=0.02)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda body: body[:-1], "truncated, it promises 1"),
        (lambda body: b"xxxx" + body[4:], "holds no SPZ"),
        (lambda body: body[:4] + b"\x09" + body[5:], "version 9"),
        (lambda body: body[:8] + b"\xff\xff\xff\xff" + body[12:], "4,294,967,295 splats"),
        (lambda body: body[:12] + b"\xc8" + body[13:], "harmonics of degree 200, at most 4"),
        (lambda body: body[:13] + b"\xff" + body[14:], "bits behind the point: 255, at most 24"),
    ],
)
def test_damage_is_told(tmp_path, change, words):
    one = Splats(*(np.ones(shape, np.float32) for shape in ((1, 3), (1, 4), (1, 3), 1, (1, 1, 3))))
    path = tmp_path / "bad.spz"
    path.write_bytes(gzip.compress(change(gzip.decompress(pack_spz(one)))))
    with pytest.raises(F4xError, match=words):
        open_any(path)
