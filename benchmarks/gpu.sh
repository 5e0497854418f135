#!/usr/bin/env bash
# Installs, tests and measures on a GPU, in one run of some ten minutes: benchmarks/gpu.sh [FOLDER]
#
# Results go to FOLDER (gpu-results): machine.txt, tests.txt, throughput.json, diagnosis.json, training.json. What fails
# is told and the rest goes on; the exit code is that of the tests. SECONDS_LEFT (570) bounds all of it; INSTALLED=1
# takes the Python of now as it is; WITH_MJX=1 installs MJX for CUDA 12 too, which is large.
set -uo pipefail
cd "$(dirname "$0")/.."
folder=$(realpath -m "${1:-gpu-results}")
limit=${SECONDS_LEFT:-570}
mkdir -p "$folder"
export OMP_NUM_THREADS=1 PYTHONUNBUFFERED=1
left() { echo $((limit - SECONDS)); }
say() { echo "[$SECONDS s] $*" >&2; }

if [ -z "${INSTALLED:-}" ]; then
  say "installing"
  python3 -m venv "$folder/venv" && . "$folder/venv/bin/activate"
  add() { python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt "$@"; }
  add --editable '.[gpu]' pytest hypothesis || exit 1
  [ -z "${WITH_MJX:-}" ] || add 'jax[cuda12]' mujoco-mjx gymnasium || say "MJX is left out"
fi
{ nvidia-smi; python -m pip list 2>/dev/null | grep -i -E 'torch|warp|mujoco|numba|jax'; nproc; git log -1 --oneline; } \
  > "$folder/machine.txt" 2>&1
python - <<'PY' || exit 2
import sys
import torch
from vpptwin.system.errors import InputError
from vpptwin.train.env.device_env import check_warp
from vpptwin.train.env.environments import find_device
try:
    check_warp(find_device("cuda"))
except InputError as error:
    sys.exit(str(error))
print(torch.cuda.get_device_name(0))
PY

say "tests"
timeout "$(($(left) / 3))" python -m pytest -q tests/twin/test_specialize.py tests/twin/test_warp_step.py \
  tests/twin/test_warp_replay.py tests/twin/test_warp_mujoco.py tests/train/test_device_env.py > "$folder/tests.txt" 2>&1
tested=$?
tail -1 "$folder/tests.txt" >&2

say "throughput"
timeout "$(($(left) / 2))" python benchmarks/throughput.py --device cuda --rounds 3 --seconds 0.5 --threads "$(nproc)" \
  --json "$folder/throughput.json" | tee "$folder/throughput.md"

say "diagnosis"
timeout "$(($(left) / 3))" python benchmarks/device_diagnosis.py --device cuda --json "$folder/diagnosis.json" \
  > "$folder/diagnosis.txt" 2>&1 || tail -1 "$folder/diagnosis.txt" >&2

say "training"
begun=$SECONDS
timeout "$(($(left) * 2 / 3))" python -m vpptwin train task=flip preset=card progress=false "out=$folder/flip" 2> "$folder/training.txt"
trained=$((SECONDS - begun))
timeout "$(left)" python -m vpptwin evaluate "$folder/flip" --json - > "$folder/evaluation.json" 2>> "$folder/training.txt"
python - "$folder" "$trained" <<'PY'
import json, pathlib, re, sys
folder, seconds = pathlib.Path(sys.argv[1]), int(sys.argv[2])
said = (folder / "training.txt").read_text()
steps = re.search(r"(\d+) steps in (\d+) s", said)
text = (folder / "evaluation.json").read_text().strip()
result = {"seconds_with_start": seconds, "steps": steps and int(steps[1]), "seconds": steps and int(steps[2]),
          "evaluation": json.loads(text) if text else None}
(folder / "training.json").write_text(json.dumps(result, indent=1) + "\n")
print(json.dumps({k: result[k] for k in ("steps", "seconds", "seconds_with_start")}))
PY

if python -c "import jax; assert jax.default_backend() == 'gpu'" 2>/dev/null && [ "$(left)" -gt 60 ]; then
  say "MJX"
  timeout "$(left)" python benchmarks/peers.py --json "$folder/peers.json" > "$folder/peers.md" 2>&1
fi
say "results in $folder"
exit $tested
