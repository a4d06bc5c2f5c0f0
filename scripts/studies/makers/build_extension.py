# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the extension zip for Blender: the add-on, the engine as a wheel and, if asked, all that the engine needs.

    scripts/build_extension                                    the add-on and the engine's code (small)
    scripts/build_extension --with-dependencies linux-x64      everything: works offline, 191 MB

The zip that holds everything is for one Python (--python) and has its number in its name. It runs itself in the .venv
of scripts/setup_environment, for pip, packaging and, unless --blender names a Blender, the bpy wheel.
"""

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

from scripts.studies import ROOT, parser

PLATFORMS = {
    "linux-x64": ["manylinux1_x86_64", "manylinux2010_x86_64", "manylinux2014_x86_64"]
    + [f"manylinux_2_{minor}_x86_64" for minor in range(5, 32)],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{major}_0_{arch}" for major in range(11, 15) for arch in ("arm64", "universal2")]
    + ["macosx_10_9_universal2"],
}
SYS_PLATFORM = {"linux-x64": "linux", "windows-x64": "win32", "macos-arm64": "darwin"}
BLENDER_HAS = {"numpy"}  # and must keep its own


def run(*command) -> None:
    """Runs a command; ends this program with its output if it fails."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"error: {' '.join(map(str, command))}\n{done.stdout}{done.stderr}")


def build_engine_wheel(into: Path) -> None:
    """The engine's wheel, built from a copy so that nothing is left in the source tree."""
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "source"
        shutil.copytree(ROOT / "btfsep_engine", copy / "btfsep_engine", ignore=shutil.ignore_patterns("__pycache__"))
        for name in ("pyproject.toml", "LICENSE", "README.md"):
            if (ROOT / name).is_file():
                shutil.copy(ROOT / name, copy)
        options = ["--no-build-isolation"] if importlib.util.find_spec("setuptools") else []
        run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", *options, "-w", into, copy)


def locked_requirements(python: str, platform: str) -> list[str]:
    """Lines for pip: what the engine needs at run time, as pinned and hashed in requirements.lock.

    The lock names behind each package what asked for it ("# via"); following these from the engine's own
    dependencies leaves out what only tests and Blender-as-a-module need.
    """
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    environment = {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "sys_platform": SYS_PLATFORM[platform],
        "platform_system": {"win32": "Windows", "darwin": "Darwin"}.get(SYS_PLATFORM[platform], "Linux"),
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = {canonicalize_name(Requirement(line).name) for line in project["dependencies"]}
    pinned, asked_by = {}, {}
    text = (ROOT / "requirements.lock").read_text()
    for block in re.split(r"\n(?=[A-Za-z0-9])", text):
        head = re.match(r"([A-Za-z0-9._-]+==[^\s;\\]+)\s*(?:;\s*([^\\\n]+))?", block)
        if head is None:
            continue
        requirement = Requirement(head[1] + (f" ; {head[2].strip()}" if head[2] else ""))
        if requirement.marker is not None and not requirement.marker.evaluate(environment):
            continue
        name = canonicalize_name(requirement.name)
        hashes = re.findall(r"--hash=\S+", block)
        pinned[name] = " ".join([head[1], *hashes])
        comment = block.split("# via", 1)[-1]
        asked_by[name] = {canonicalize_name(word) for word in re.findall(r"[A-Za-z0-9._-]+", comment)}
    while True:
        more = {name for name, by in asked_by.items() if by & needed} - needed
        if not more:
            break
        needed |= more
    return [pinned[name] for name in sorted(needed - BLENDER_HAS) if name in pinned]


def download(into: Path, python: str, platform: str) -> None:
    """The wheels that the engine needs, for one Python and one platform."""
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as listing:
        listing.write("\n".join(locked_requirements(python, platform)))
        listing.flush()
        tags = [part for tag in PLATFORMS[platform] for part in ("--platform", tag)]
        run(
            *(sys.executable, "-m", "pip", "download", "-q", "--no-deps", "--require-hashes"),
            *("--only-binary", ":all:", "--implementation", "cp", "--python-version", python, *tags),
            *("-d", into, "-r", listing.name),
        )


def stage(folder: Path, platform: str | None, pythons: list[str]) -> None:
    """Puts the extension together in ``folder``."""
    addon = ROOT / "blender_btfsep"
    for source in [*sorted(addon.rglob("*.py")), addon / "example.blend"]:
        target = folder / source.relative_to(addon)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, target)
    if (ROOT / "LICENSE").is_file():
        shutil.copy(ROOT / "LICENSE", folder)
    wheels = folder / "wheels"
    wheels.mkdir()
    build_engine_wheel(wheels)
    if platform:
        for python in pythons:
            download(wheels, python, platform)
    listed = "".join(f'  "./wheels/{wheel.name}",\n' for wheel in sorted(wheels.glob("*.whl")))
    added = f"wheels = [\n{listed}]\n" + (f'platforms = ["{platform}"]\n' if platform else "")
    manifest = (ROOT / "blender_manifest.toml").read_text()
    (folder / "blender_manifest.toml").write_text(manifest.replace("[permissions]", f"{added}\n[permissions]"))


def extension_tool(blender: str | None) -> list[str]:
    """The command of Blender's own tool for extensions."""
    if blender:
        return [blender, "--command", "extension"]
    found = importlib.util.find_spec("bpy")
    if found is not None:
        for tool in Path(found.origin).parent.rglob("bl_pkg/cli/blender_ext.py"):
            return [sys.executable, str(tool)]
    raise SystemExit("error: neither --blender nor the bpy wheel; run scripts/setup_environment first")


def zip_name(version: str, platform: str | None, pythons: list[str]) -> str:
    """One name for each content: wheels are of one platform and of certain Pythons."""
    parts = [platform, *(f"py{python.replace('.', '')}" for python in pythons)] if platform else []
    return "-".join(["btfsep", version, *parts]) + ".zip"


def without_engine(pythons: list[str]) -> list[str]:
    """Those of ``pythons`` for which the engine, or what it needs, is not made."""
    from packaging.specifiers import SpecifierSet

    made_for = SpecifierSet(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"])
    return [python for python in pythons if f"{python}.0" not in made_for]


def main(arguments) -> None:
    options = parser("build-extension", __doc__)
    options.add_argument("--output", type=Path, default=ROOT / "dist", help="folder for the zip (default: dist)")
    options.add_argument("--with-dependencies", metavar="PLATFORM", choices=sorted(PLATFORMS), help="/".join(PLATFORMS))
    options.add_argument("--python", action="append", help="Python of the Blender to build for (default: 3.11)")
    options.add_argument("--blender", help="a Blender to build and validate with, instead of the bpy wheel")
    given = options.parse_args(arguments)
    tool = extension_tool(given.blender)
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    given.output.mkdir(parents=True, exist_ok=True)
    pythons = given.python or ["3.11"]
    if given.with_dependencies and without_engine(pythons):
        raise SystemExit(
            f"error: Python {', '.join(without_engine(pythons))}; there is no engine for it; build without "
            "--with-dependencies, and give the .venv of the source tree in the extension's preferences"
        )
    target = given.output / zip_name(version, given.with_dependencies, pythons)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        stage(folder, given.with_dependencies, pythons)
        run(*tool, "build", "--source-dir", folder, "--output-filepath", target)
    run(*tool, "validate", target)
    print(f"{target} ({target.stat().st_size / 1e6:.1f} MB)")
