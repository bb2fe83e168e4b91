"""Jobs: progress and results arrive, a cancelled child is gone with its children, a vanished Blender leaves no orphan."""

import importlib
import json
import os
import signal
import stat
import subprocess
import sys
import time
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))
import door  # noqa: E402

door.load_extension()
worker = importlib.import_module("feature4x.addon.jobs.worker")
errors = importlib.import_module("feature4x.f4x_core.errors")
NEEDS_BLENDER = False
POSIX = pytest.mark.skipif(os.name == "nt", reason="asks for process ids as POSIX has them")

# A child with a child of its own; both tell their number. It answers an interrupt only where it is told to.
FAMILY = """
import signal, subprocess, sys, time
from f4x_core.processes import LineProgress, stop_with_parent
tell = LineProgress(sys.stdout)
stop_with_parent()
if sys.argv[1] == "deaf":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
other = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
try:
    tell("working", 1, 4, str(other.pid))
    time.sleep(60)
except KeyboardInterrupt:
    open(sys.argv[2], "w").write("saved")
"""


def is_alive(process: int) -> bool:
    try:
        text = Path(f"/proc/{process}/stat").read_text()
    except FileNotFoundError:
        return False
    return text.rpartition(")")[2].split()[0] != "Z"


def wait_until(condition, seconds: float) -> float:
    """Seconds that it took; fails when it takes longer than `seconds`."""
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < seconds, "took too long"
        time.sleep(0.01)
    return time.monotonic() - start


def ended(code: str, *arguments: str, patience: float = 60.0):
    job = worker.Job("test", [sys.executable, "-c", code, *arguments], patience=patience)
    job.wait()
    return job


def test_progress_log_and_result():
    seen = []
    code = """
import sys
from f4x_core.processes import LineProgress
tell = LineProgress(sys.stdout)
print("a library prints"); print("[1, 2]"); print("warned", file=sys.stderr)
tell("fit", 3, 12, "step 3")
tell.tell(result={"scene": "x.f4x"}, text="one\\ntwo")
"""
    job = worker.Job("test", [sys.executable, "-c", code], seen.append)
    shown = []  # what the window draws before the result keeps it busy
    job.wait(lambda running: shown.append((running.arrived, list(seen))))
    assert shown[-1] == (True, [])
    assert (job.state, job.result) == (worker.DONE, {"scene": "x.f4x"})
    assert (job.stage, job.done, job.total, job.message, job.fraction) == ("fit", 3, 12, "step 3", 0.25)
    assert seen == [{"scene": "x.f4x"}]
    assert {"a library prints", "[1, 2]", "warned", "one", "two"} == set(job.log)


def test_a_verb_of_the_core_tells_lines(tmp_path):
    job = worker.Job("info", worker.core_command(sys.executable, "info", tmp_path / "absent.f4x"))
    job.wait()
    assert (
        job.state == worker.FAILED
        and "absent.f4x" in job.error
        and job.error.endswith("[F4X-SCENE]")
        and "Traceback" not in "".join(job.log)
    )
    assert job.stage == "start" and job.message.startswith("f4x ")


def test_what_fails_after_the_job_is_its_error():
    def refuse(result):
        raise errors.F4xError("cannot be imported")

    code = "import json; print(json.dumps({'result': {}}))"
    job = worker.Job("test", [sys.executable, "-c", code], refuse)
    job.wait()
    assert (job.state, job.error) == (worker.FAILED, "cannot be imported. [F4X-INSTALL]")


def test_a_mistake_after_the_job_is_its_error_too(capsys):
    def stumble(result):
        raise KeyError("scene")

    code = "import json; print(json.dumps({'result': {}}))"
    job = worker.Job("test", [sys.executable, "-c", code], stumble)
    job.wait()
    assert job.state == worker.FAILED and not job.poll()
    assert job.error.startswith("The task is done") and job.error.endswith("[F4X-OTHER]") and "'scene'" in job.error
    assert "in stumble" in "".join(job.log) and "in stumble" in capsys.readouterr().err


@POSIX
@pytest.mark.parametrize("kind", ["deaf", "willing"])
def test_cancel_ends_the_whole_family(tmp_path, kind):
    saved = tmp_path / "saved"
    job = worker.Job("test", [sys.executable, "-c", FAMILY, kind, str(saved)])
    wait_until(lambda: not job.poll() or job.message, 20)
    family = (job.child.pid, int(job.message))
    assert all(map(is_alive, family))
    start = time.monotonic()
    job.cancel()
    assert time.monotonic() - start < 0.1  # it does not wait
    wait_until(lambda: not job.poll(), 2)
    took = wait_until(lambda: not any(map(is_alive, family)), 2) + time.monotonic() - start
    print(f"{kind}: the family was gone after {took:.2f} s")
    assert job.state == worker.CANCELLED and time.monotonic() - start < 2
    assert saved.exists() == (kind == "willing")


@POSIX
@pytest.mark.parametrize("kind", ["deaf", "willing"])
def test_no_orphan_when_blender_is_killed(tmp_path, kind):
    blender = f"""
import sys, time
sys.path.insert(0, {str(ROOT / "scripts")!r})
import door
door.load_extension()
from feature4x.addon.jobs.worker import Job
job = Job("test", [sys.executable, "-c", sys.argv[1], sys.argv[2], sys.argv[3]])
while job.poll() and not job.message:
    time.sleep(0.01)
print(job.child.pid, job.message, flush=True)
time.sleep(60)
"""
    with subprocess.Popen(
        [sys.executable, "-c", blender, FAMILY, kind, str(tmp_path / "saved")], stdout=subprocess.PIPE, text=True
    ) as parent:
        family = [int(word) for word in parent.stdout.readline().split()]
        assert len(family) == 2 and all(map(is_alive, family))
        parent.send_signal(signal.SIGKILL)
        took = wait_until(lambda: not any(map(is_alive, family)), 2)
        print(f"{kind}: gone {took:.2f} s after Blender")
    assert (tmp_path / "saved").exists() == (kind == "willing")


def test_nothing_of_blenders_python_reaches_the_worker(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("PYTHONHOME", sys.prefix)
    code = "import json, os; print(json.dumps({'result': {n: v for n, v in os.environ.items() if n[:6] == 'PYTHON'}}))"
    assert ended(code).result == {"PYTHONUTF8": "1"}


def script(path: Path, text: str) -> str:
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


@POSIX
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("#!/bin/sh\necho this is no Python >&2\nexit 3\n", "is no Python that can run Feature4X (this is no Python)"),
        ("#!/bin/sh\nexit 0\n", "is no Python that can run Feature4X (it printed nothing)"),
        ("#!/bin/sh\nsleep 60\n", "did not answer within"),
        ("#!/bin/sh\nwhile true; do echo 'chatter'; done\n", "did not answer within"),
        ("#!/absent/interpreter\n", "cannot be run"),
        ("\x7fELF but not really", "cannot be run"),
    ],
)
def test_an_interpreter_that_is_none(tmp_path, text, said):
    python = script(tmp_path / "python", text)
    try:
        patience = (
            0.5 if said.startswith("did not answer") else 60.0
        )  # the others end by themselves, late on a busy machine
        job = worker.Job("test", worker.core_command(python, "doctor"), patience=patience)
        job.wait()
        assert job.state == worker.FAILED
        sentence, process = job.error, job.child.pid
        assert sentence.endswith("[F4X-INSTALL]")
        assert not is_alive(process)
    except errors.F4xError as error:
        sentence = str(error)
    assert said in sentence and python in sentence and "\n" not in sentence


def test_an_interpreter_that_is_not_there(tmp_path):
    with pytest.raises(errors.F4xError, match="is missing or cannot be run"):
        worker.Job("test", worker.core_command(tmp_path / "python", "doctor"))


def test_an_interpreter_without_packages(tmp_path):
    venv.create(tmp_path / "bare", with_pip=False)
    python = tmp_path / "bare" / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    job = worker.Job("test", worker.core_command(python, "doctor"))
    job.wait()
    assert job.state == worker.FAILED and "has no package" in job.error and str(python) in job.error


def test_a_program_that_only_stays_is_stopped_by_its_input(tmp_path):
    """What the command line promises to any program: it stops when the pipe on its standard input closes."""
    command = [sys.executable, "-c", FAMILY, "willing", str(tmp_path / "saved")]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as child:
        other = int(json.loads(child.stdout.readline())["message"])
        child.stdin.close()
        assert child.wait(3) == 0 and (tmp_path / "saved").exists()
    os.kill(other, signal.SIGTERM)
