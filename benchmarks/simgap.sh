#!/usr/bin/env bash
# A judged board of SimGap: draws a secret set, commits its manifest before anybody answers, runs all entrants, publishes
# the seed and the board. Run it again after an interruption: what is drawn and answered stays. From the repository:
#   benchmarks/simgap.sh FOLDER [NUMBERS]
# All ten entrants together take, minutes a session on one core: watched 0.5; pendula 1.5; carts, servos, quadrotors,
# pairs 2; cart-poles, double pendula 2.5; drones, legs 4.5; arms 6 (and 2 GB). By default that is two and a half hours.
set -euo pipefail
folder=${1:?folder of the set} out=benchmarks/results/simgap
numbers=${2:-0:3,carts=3:6,pendula=3:6,cart-poles=3:6,double-pendula=3:6,servos=3:6,quadrotors=3:6,pairs=3:6,watched=3:12}
simgap() { nice .venv/bin/python -m proving.simgap "$@"; }
[[ -z "$(git status --porcelain --untracked-files=no)" ]] || { echo "commit first: the board names one commit"; exit 1; }
if [[ ! -f "$folder/manifest.json" ]]; then
    drawn=$(simgap draw "$folder" --secret --numbers "$numbers")
    drawn=${drawn##*the seed is }
    (umask 077; echo "${drawn%%:*}" > "$folder.seed")
    cp "$folder/manifest.json" "$out/manifest.json"
    git commit -qm "SimGap: the manifest of a set to be judged, before anybody answers it" "$out/manifest.json"
fi
simgap run "$folder"
simgap board "$folder" --seed "$(cat "$folder.seed")" --out "$out"
cp "$folder/manifest.json" "$out/manifest.json"
