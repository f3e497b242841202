#!/bin/sh
# The models at the paper's size: sets of 8,000 and 15,000 episodes, preset `base`, about 20 passes over each set.
#
#     GPUS=1 OUT=out/full sh examples/paper/full_scale.sh
#
# One model takes about 22 hours on the smaller set and 43 on the larger one on two idle CPU cores, so this wants GPUs.
# It needs the objects of YCB: candata fetch ycb --from FOLDER --out out/ycb. A script that was stopped goes on when it is
# started again: sets with the episodes that are missing, runs from their last checkpoint, also on another number of GPUs.
set -eu

GPUS=${GPUS:-1}
OUT=${OUT:-out/full}
MODELS=${MODELS:-"mlp diffusion_unet contact_diffusion"}
BATCH=256

for set in mustard forty; do
    case $set in
        mustard) steps=76000 ;;  # 20 passes over 970,000 windows
        forty) steps=152000 ;;   # 20 passes over 1,940,000 windows
    esac
    candata generate-sim --recipe "examples/paper/$set.yaml" --out "$OUT/$set"
    for model in $MODELS; do
        torchrun --standalone --nproc-per-node "$GPUS" -m candata_cli.main train --data "$OUT/$set" --model "$model" \
            --preset base --batch "$BATCH" --steps "$steps" --device cuda --out "$OUT/runs/$set-$model"
        candata evaluate "$OUT/runs/$set-$model" "$OUT/$set" --device cuda
    done
done
