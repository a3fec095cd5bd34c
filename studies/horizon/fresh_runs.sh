#!/usr/bin/env bash
# Train the 120 runs of results/horizon/registered.md into the folder OUT (default: runs). Interrupted at any point, the
# same command goes on where it stopped. Versions: Python 3.11, pip install -c studies/horizon/constraints.txt .
set -euo pipefail
out=${OUT:-runs}
train() { perdure train "$@" --seeds 10 11 12 13 14 15 16 17 18 19 --out "$out"; }
walkers="Hopper-v3 Walker2d-v3"
for method in ppo geometric; do
  for task in $walkers; do train "$task" --preset cleanrl --method "$method"; done
  train HalfCheetah-v3 --preset zoo --method "$method"
done
for task in $walkers; do train "$task" --preset cleanrl --method geometric --name geometric-discounted --ppo.protocol.gamma 0.99; done
train HalfCheetah-v3 --preset zoo --method geometric --name geometric-discounted --ppo.protocol.gamma 0.98
for task in $walkers; do train "$task" --preset cleanrl --method ppo --name ppo-gamma-0.999 --ppo.protocol.gamma 0.999; done
train HalfCheetah-v3 --preset zoo --method ppo --name ppo-gamma-0.999 --ppo.protocol.gamma 0.999
