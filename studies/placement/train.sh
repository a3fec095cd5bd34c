#!/bin/sh
# Train 11 skills and 5 variants of place, each with three seeds, then score and ship them. Run it again to go on
# after a stop.
# usage: studies/placement/train.sh [OUT [CORES]], with perdure's environment active
set -eu
out=${1:-runs/home} cores=${2:-2}
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
mkdir -p "$out"
for task in set_table prepare_groceries tidy_house; do  # start states, with the policies that are shipped so far
	python -c "from perdure.home.evaluate.plan_starts import record_plan_starts as record; record('$task')"
done
{
	for seed in 0 1 2; do
		for each in set_table:pick set_table:place prepare_groceries:place prepare_groceries:pick tidy_house:pick tidy_house:place \
			set_table:open_drawer set_table:open_fridge set_table:close_fridge set_table:navigate set_table:close_drawer; do
			echo "${each#*:} --task ${each%:*} --seeds $seed"
		done
		for variant in "variant gentle" "variant hand" "variant delta-200" "method linear" "method geometric"; do
			echo "place --task set_table --seeds $seed --$variant"
		done
	done
} | OUT=$out xargs -P "$cores" -L 1 sh -c 'perdure home train "$@" --test-episodes 1 --cores 1 --on here --out "$OUT" \
	>"$OUT/$1-$3-$5${7:+-}${7-}.txt" 2>&1 || { tail -3 "$OUT/$1-$3-$5${7:+-}${7-}.txt" >&2; exit 1; }' train
python "$(dirname "$0")/../../tools/ship_home.py" "$out"
