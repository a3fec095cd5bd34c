#!/bin/bash
# plantest.sh: each task in the closed plan on val, training seeds given by N
export OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
cd /work/main; N=${N:-2}
P=/root/pol
for t in set_table tidy_house prepare_groceries; do
  pol="pick=$P/$t/pick/seed-{seed}.safetensors place=$P/$t/place/seed-{seed}.safetensors navigate=$P/set_table/navigate/seed-{seed}.safetensors"
  [ $t = set_table ] && pol="$pol open_drawer=$P/set_table/open_drawer/seed-{seed}.safetensors close_drawer=$P/set_table/close_drawer/seed-{seed}.safetensors open_fridge=$P/set_table/open_fridge/seed-{seed}.safetensors close_fridge=$P/set_table/close_fridge/seed-{seed}.safetensors"
  [ $t = prepare_groceries ] && pol="$pol open_fridge=$P/set_table/open_fridge/seed-{seed}.safetensors"
  .venv/bin/perdure home run $t --place rl --planner closed --train-seeds $N --policies $pol --cores 1 --out /root/plantest
done
