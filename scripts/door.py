"""What every door without a window needs: the repository as one package, the arguments, an honest exit code.

A door runs as `python scripts/NAME.py ARGS` (bpy wheel) or `blender -b -P scripts/NAME.py -- ARGS`.
"""

import importlib.util
import os
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "feature4x"


def load_extension() -> ModuleType:
    """Import the repository root as the package `feature4x`, the way Blender imports the installed extension."""
    if PACKAGE not in sys.modules:
        spec = importlib.util.spec_from_file_location(
            PACKAGE, ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
        )
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[PACKAGE] = module
        spec.loader.exec_module(module)
    return sys.modules[PACKAGE]


def arguments() -> list[str]:
    """The arguments meant for the script: what follows `--` in Blender, all of them in plain Python.

    Raises:
        F4xError: Blender without `--`.
    """
    if "--" in sys.argv:
        return sys.argv[sys.argv.index("--") + 1 :]
    if Path(sys.argv[0]).suffix != ".py":  # then it is Blender's own path, and all that follows is Blender's
        from feature4x.f4x_core.errors import F4xError

        raise F4xError("write -- before the arguments of the script: blender -b -P SCRIPT.py -- SCENE.f4x OUT.blend")
    return sys.argv[1:]


def run(main: Callable[[list[str]], None]) -> None:
    """Run `main(arguments)` and leave with 0, 2 (one clear sentence) or 1 (traceback).

    The process ends in os._exit because bpy 4.5 hangs at interpreter exit while classes are registered.
    """
    load_extension()
    from feature4x.f4x_core.errors import F4xError

    code = 0
    try:
        main(arguments())
    except F4xError as error:
        print(f"error: {error}", file=sys.stderr)
        code = 2
    except SystemExit as exit_request:  # argparse: --help or a usage error
        code = exit_request.code if isinstance(exit_request.code, int) else 1
    except Exception:
        sys.excepthook(*sys.exc_info())
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)
