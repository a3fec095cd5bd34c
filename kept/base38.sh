#!/bin/bash
jobs() {
for seed in 1 2; do
  for t in prepare_groceries tidy_house set_table; do echo "pick $t $seed"; echo "place $t $seed"; done
  for s in open_drawer open_fridge close_fridge navigate close_drawer; do echo "$s set_table $seed"; done
done
for v in hand delta-200; do echo "place set_table 0 $v"; done
for m in linear geometric; do echo "place set_table 0 '' $m"; done
}
jobs | xargs -P ${CORES:-2} -I{} bash -c "/root/one38.sh {}"
