"""One window of a long clip, fitted in a process of its own."""

import dataclasses

import numpy as np
import pytest
from toy import cameras as cameras_of
from toy import clip_and_priors

from f4x_core.clip.model import Picture
from f4x_core.clip.notes import Remark
from f4x_core.errors import Cancelled, F4xError
from f4x_core.fit.config import profile
from f4x_core.scene import read_scene
from f4x_core.windows import window
from f4x_core.windows.plan import Shot
from f4x_core.windows.shots import LongFit, fit_shot

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def request_of(tmp_path):
    """Requests for the fit of one window, in folders of their own; a child finds the toy's true priors in files."""
    clip, priors = clip_and_priors(8)
    np.save(tmp_path / "depth.npy", priors.depth)
    priors.cameras.write(tmp_path / "cameras.json")
    files = {"depth": str(tmp_path / "depth.npy"), "cameras": str(tmp_path / "cameras.json")}
    quick = profile("quick")
    scaffold = dataclasses.replace(quick.scaffold, geometry_steps=10, following_steps=10, max_nodes=8)
    config = dataclasses.replace(quick, steps=20, checkpoint_every=5, threads=1, scaffold=scaffold)
    config = dataclasses.replace(config, priors=dataclasses.replace(config.priors, files=files))

    def write(name, resume=False):
        return window.WindowRequest(clip, tmp_path / name, config, None, resume).write()

    return write


def test_a_process_of_its_own_that_is_stopped_and_resumed_fits_a_window_to_the_same_bytes(request_of):
    here, apart = request_of("here"), request_of("apart")
    window.fit_here(here, lambda *_: None)
    stages = set()

    def stop(stage, done, total, message=""):
        stages.add(stage)
        if stage == "photometric" and done >= 10:
            raise Cancelled

    with pytest.raises(Cancelled):
        window.fit_apart(apart, stop)
    assert not (apart.parent / window.SCENE).exists()
    assert (apart.parent / "checkpoints" / "photometric.pt").is_file()
    window.fit_apart(request_of("apart", resume=True), lambda stage, *_: stages.add(stage))
    assert (here.parent / window.SCENE).read_bytes() == (apart.parent / window.SCENE).read_bytes()
    assert {"photometric", "evaluate"} < stages and "start" not in stages
    assert len(read_scene(here.parent / window.SCENE).static) > 100


def test_what_is_wrong_in_a_window_is_one_sentence(tmp_path):
    """That of the process that fits it; no request is left behind."""
    clip, _ = clip_and_priors(8)
    config = profile("quick")
    config = dataclasses.replace(config, priors=dataclasses.replace(config.priors, files={"depth": "no.npy"}))
    with pytest.raises(F4xError, match=r"no\.npy[^\n]*\[F4X-[A-Z]+\]$"):
        fit_shot(Shot(((0, 8),)), LongFit(lambda *_: clip, config), tmp_path)
    assert [path.name for path in (tmp_path / "windows" / "000").iterdir() if path.is_file()] == []


def test_a_request_is_read_as_it_was_written(tmp_path):
    """A clip with all that clips can have, and settings that no profile has."""
    clip, _ = clip_and_priors(8, hold_out=4)
    times = clip.times * 1.003
    cameras = cameras_of(8)
    picture = Picture(2, 0, 62, 40, 64, 40)
    masks, depth = np.zeros(clip.frames.shape[:3], bool), np.full(clip.frames.shape[:3], np.nan, np.float32)
    masks[3, 5:9] = True
    clip = dataclasses.replace(
        clip,
        times=times,
        fps=23.976023976023978,
        picked="5:13:1",
        cameras=cameras,
        masks=masks,
        depth=depth,
        picture=picture,
        hidden=~masks,
        remarks=(Remark("Something was left out.", "Give it."), Remark("Told.")),
    )
    config = profile("wild")
    found = dataclasses.replace(config.priors.cameras, focal=0.7712345678901234)
    config = dataclasses.replace(
        config, sh_degree=1, priors=dataclasses.replace(config.priors, cameras=found, files={"depth": "a b.npy"})
    )
    before = window.WindowBefore(tmp_path / "scene.f4x", 7, 41, 1234, "digest")
    asked = window.WindowRequest(clip, tmp_path / "here", config, before, True)
    read = window.WindowRequest.read(asked.write())
    assert (read.folder, read.config, read.before, read.resume) == (asked.folder, config, before, True)
    for entry in dataclasses.fields(clip):
        one, other = getattr(clip, entry.name), getattr(read.clip, entry.name)
        if isinstance(one, np.ndarray):
            assert one.dtype == other.dtype and np.array_equal(one, other, equal_nan=one.dtype.kind == "f"), entry.name
        elif entry.name == "cameras":
            assert one.to_json() == other.to_json()
        else:
            assert one == other, entry.name
    assert read.key == asked.key
