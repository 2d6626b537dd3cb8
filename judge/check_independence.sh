#!/usr/bin/env bash
# Fails unless the judge depends on the data model and on parry, serialisation and errors, and on nothing else.
set -euo pipefail
cd "$(dirname "$0")/.."
allowed='akrobat-model parry3d-f64 schemars serde thiserror'
found=$(cargo tree --package akrobat-judge --edges normal --depth 1 --prefix none --format '{p}' |
    tail -n +2 | cut -d' ' -f1 | sort -u | paste -sd' ')
if [ "$found" != "$allowed" ]; then
    echo "akrobat-judge depends on: $found; expected: $allowed" >&2
    exit 1
fi

# Tests may compare with the tree's forward kinematics; what stands before a file's tests may not use it.
for file in judge/src/*.rs; do
    [ "$(basename "$file")" = real_inputs.rs ] && continue
    if sed '/^mod tests/,$d' "$file" | grep -nE 'link_poses|parent_from_child|joint_position'; then
        echo "$file: the judge's forward kinematics must be its own" >&2
        exit 1
    fi
done
