"""Run a program: ``fishrl train task=predation``; ``fishrl`` alone lists the programs."""

import ast
import gc
import signal
import sys
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path

COMPLETION = ("-sc", "--shell-completion")


def list_programs() -> dict[str, str]:
    """Return the first line of the docstring of each program, a module with ``main``."""
    found = {}
    for path in sorted((Path(__file__).parent / "programs").glob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "main" for node in tree.body):
            lines = (ast.get_docstring(tree) or "").splitlines()
            found[path.stem.replace("_", "-")] = lines[0]
    return found


def describe_programs() -> str:
    """Return the list of programs, as ``fishrl`` alone prints it."""
    lines = [f"  {name:<20}{line}" for name, line in list_programs().items()]
    return "\n".join(
        [
            "usage: fishrl <program> key=value ...; fishrl <program> --help lists its settings\n",
            *lines,
            '\ntab completion in bash: eval "$(fishrl -sc install=bash)"; also zsh and fish',
        ]
    ).replace("``", "`")


def main() -> None:
    """Run the program that the first word of the command line names."""
    words = sys.argv[1:]
    if not words or words[0] in ("-h", "--help"):
        sys.stdout.write(describe_programs() + "\n")
        return
    # Until the program begins: searching what imports make for garbage would take seconds, and
    # Ctrl-C ends the program without a traceback.
    gc.disable()
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if words[0] in COMPLETION:
        import_module("fishrl.programs.completion").answer(list_programs())
        return
    if words[0] not in (known := list_programs()):
        near = get_close_matches(words[0], known, n=1)
        there = f"did you mean {near[0]!r}?" if near else f"there is: {', '.join(known)}"
        sys.exit(f"error: there is no program {words[0]!r}; {there}")
    del sys.argv[1]
    import_module(f"fishrl.programs.{words[0].replace('-', '_')}").main()


if __name__ == "__main__":
    main()
