#!/usr/bin/env bash
# A judged board of SimGap: draws a secret set, commits its manifest before anybody answers, runs all entrants, publishes
# the seed and the board. Run it again after an interruption: what is drawn and answered stays. From the repository:
#   benchmarks/simgap.sh FOLDER [NUMBERS]
# Processor time of all ten entrants, minutes a session: watched 1; pendula 1.5; carts, quadrotors, servos 2;
# cart-poles, double pendula 2.5; drones 4.5; legs LEGS; arms ARMS.
set -euo pipefail
folder=${1:?folder of the set} out=benchmarks/results/simgap
numbers=${2:-carts=0:6,pendula=0:6,cart-poles=0:6,double-pendula=0:6,servos=0:6,quadrotors=0:6,watched=0:12,drones=0:3,legs=0:3,arms=0:2}
simgap() { .venv/bin/python -m proving.simgap "$@"; }
[[ -z "$(git status --porcelain --untracked-files=no)" ]] || { echo "commit first: the board names one commit"; exit 1; }
if [[ ! -f "$folder/manifest.json" ]]; then
    drawn=$(simgap draw "$folder" --secret --numbers "$numbers")
    drawn=${drawn##*the seed is }
    (umask 077; echo "${drawn%%:*}" > "$folder.seed")
    cp "$folder/manifest.json" "$out/manifest.json"
    git commit -qm "SimGap: the manifest of a set to be judged, before anybody answers it" "$out/manifest.json"
fi
nice simgap run "$folder"
simgap board "$folder" --seed "$(cat "$folder.seed")" --out "$out"
cp "$folder/manifest.json" "$out/manifest.json"
