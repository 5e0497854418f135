"""What the exported controller costs on a Cortex-M4F: flash, RAM, and instructions counted under emulation.

    python benchmarks/cortex_m4.py flip --json cortex.json

Cross-compiled with Debian's gcc-arm-none-eabi, run by qemu-system-arm (apt install gcc-arm-none-eabi
libnewlib-arm-none-eabi qemu-system-arm). QEMU counts instructions, not cycles: on an M4 most take one, divisions and
square roots 14, loads two, so read a budget of 168 MHz with a factor of two in hand.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from same_rig.report import describe_machine  # noqa: E402

from vpptwin.deploy.c_source import write_c  # noqa: E402
from vpptwin.deploy.content import collect_content  # noqa: E402

COMPILER, SIZE, EMULATOR = "arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm"
FLAGS = (
    "-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard", "-std=c99", "-Wall", "-Wextra", "-Werror",
    "-Wdouble-promotion", "-ffunction-sections", "-fdata-sections", "-fno-math-errno",
)  # fmt: skip
CLOCK = 168e6
"""Of the flight controller, Hz."""
PERIODS = {"policy": 0.01, "cascade_map": 0.001, "cascade_adaptive": 0.001}
"""How often each part runs, s."""


def build(folder: Path, level: str) -> Path:
    """Compile the exported source in a folder and the counting program; the image."""
    for name in ("main.c", "link.ld"):
        shutil.copy(HERE / "cortex" / name, folder)
    image = folder / f"image{level}.elf"
    objects = []
    for source, extra in (("vpptwin.c", ()), ("main.c", ("-std=gnu11",))):
        objects.append(folder / f"{source}{level}.o")
        run([COMPILER, *FLAGS, *extra, level, "-c", str(folder / source), "-o", str(objects[-1])])
    link = ["-nostartfiles", "-Wl,--gc-sections", f"-Wl,-T,{folder / 'link.ld'}", "--specs=nosys.specs"]
    run([COMPILER, *FLAGS, level, *map(str, objects), *link, "-lm", "-o", str(image)])
    return image


def run(command: Sequence[str]) -> str:
    """Output of a command; exits with its complaint if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    if done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def measure(image: Path, module: Path) -> dict[str, int]:
    """Instructions of each part, bytes of flash and RAM."""
    machine = ["-M", "mps2-an386", "-nographic", "-icount", "shift=0,align=off,sleep=off"]
    said = run([EMULATOR, *machine, "-semihosting-config", "enable=on,target=native", "-kernel", str(image)])
    counts = {name: int(value) for name, value in (line.split() for line in said.splitlines() if line.count(" ") == 1)}
    text, data, bss = map(int, run([SIZE, str(module)]).splitlines()[1].split()[:3])
    whole_text, whole_data, whole_bss = map(int, run([SIZE, str(image)]).splitlines()[1].split()[:3])
    return counts | {
        "flash": text + data, "ram": data + bss, "image_flash": whole_text + whole_data,
        "image_ram": whole_data + whole_bss,
    }  # fmt: skip


def main(argv: Sequence[str] | None = None) -> int:
    """Export, compile, run, print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("checkpoint", help="as of `vpptwin export`")
    parser.add_argument("--json", type=Path, help="write the results here")
    args = parser.parse_args(argv)
    missing = [tool for tool in (COMPILER, SIZE, EMULATOR) if shutil.which(tool) is None]
    if missing:
        sys.exit(f"{', '.join(missing)} not found: apt install gcc-arm-none-eabi libnewlib-arm-none-eabi {EMULATOR}")
    results = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_c(collect_content(args.checkpoint), folder)
        for level in ("-Os", "-O2", "-O3"):
            image = build(folder, level)
            results[level] = measure(image, folder / f"vpptwin.c{level}.o")
    print(
        "| | flash [kB] | RAM [B] | policy, instructions | share of 10 ms | cascade, map | adaptive | share of 1 ms |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for level, r in results.items():
        if r["failed"]:
            sys.exit(f"{level}: test vectors fail on the target")
        policy, adaptive = (r[part] / CLOCK / PERIODS[part] for part in ("policy", "cascade_adaptive"))
        print(
            f"| {level} | {r['flash'] / 1000:.1f} | {r['image_ram']} | {r['policy']:,} | {policy:.2%} | "
            f"{r['cascade_map']:,} | {r['cascade_adaptive']:,} | {adaptive:.2%} |"
        )
    if args.json:
        args.json.write_text(
            json.dumps(describe_machine() | {"checkpoint": args.checkpoint, "results": results}) + "\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
