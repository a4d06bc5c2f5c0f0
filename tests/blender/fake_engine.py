# SPDX-License-Identifier: GPL-3.0-or-later
"""A real child process that speaks the engine's protocol, for tests of what stands on the other side of it.

fake_engine.py BEHAVIOUR-FILE ARGUMENTS… --json: does what the file's JSON says, so that a test chooses by a file.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path


def say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def main():
    behaviour = json.loads(Path(sys.argv[1]).read_text())
    arguments = sys.argv[2:]
    if arguments[0] == "serve" and "serve" not in behaviour:  # as an engine that cannot stay
        sys.stderr.write("error: No such command 'serve'.\n")
        sys.exit(2)
    if "log" in behaviour:
        Path(behaviour["log"]).write_text(json.dumps(arguments))
    if behaviour.get("deaf"):
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
    if "child" in behaviour:
        child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
        Path(behaviour["child"]).write_text(f"{os.getpid()} {child.pid}")
    for line in behaviour.get("lines", []):
        if isinstance(line, str):
            sys.stdout.write(line + "\n")
            sys.stdout.flush()
        else:
            say(**line)
    sys.stderr.write(behaviour.get("stderr", ""))
    sys.stderr.flush()
    if "lighting" in behaviour and arguments[0] == "estimate":
        out = Path(arguments[arguments.index("--out") + 1])
        out.mkdir(parents=True, exist_ok=True)
        (out / "lighting.json").write_text(json.dumps(behaviour["lighting"]))
        (out / "result.json").write_text("{}")
        result = behaviour.get("result", {}) | {"out": str(out), "lighting": str(out / "lighting.json")}
        say(type="done", result=result)
    if "aligned" in behaviour and arguments[0] == "align":
        out = Path(arguments[arguments.index("--out") + 1])
        out.mkdir(parents=True, exist_ok=True)
        job = json.loads((Path(arguments[1]) / "job.json").read_text())
        job["camera"] |= behaviour["aligned"]
        job |= behaviour.get("job", {})
        (out / "job.json").write_text(json.dumps(job))
        say(type="done", result=behaviour["result"] | {"out": str(out)})
    if "sequence" in behaviour and arguments[0] == "sequence":
        out = Path(arguments[arguments.index("--out") + 1])
        out.mkdir(parents=True, exist_ok=True)
        frames = []
        for image, lighting in behaviour["sequence"].items():
            frames.append(
                {"image": image, "lighting": f"{Path(image).stem}.json", "residual": 0.25, "determined": "all"}
            )
            (out / frames[-1]["lighting"]).write_text(json.dumps(lighting))
        say(type="done", result=behaviour.get("result", {}) | {"out": str(out), "frames": frames})
    time.sleep(behaviour.get("sleep", 0))
    if "signal" in behaviour:
        os.kill(os.getpid(), behaviour["signal"])
    sys.exit(behaviour.get("exit", 0))


main()
