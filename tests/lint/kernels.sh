#!/bin/bash
# The kernels in clang's eyes: every file of kernels/cl by itself, without a warning, as OpenCL C 1.2. For two targets, for CPU and
# GPU, for every sample type, and where axes are uneven. CLANG names another clang.
set -euo pipefail
cd "$(dirname "$0")/../../kernels/cl"

# What kernels/src/tuning.rs has for a CPU and a GPU.
cpu='-DGROUP=1 -DWIDE_GROUP=1 -DBRICK_GROUP=1 -DLANES=16 -DRUN=1 -DPREFETCHES=1'
gpu='-DGROUP=256 -DWIDE_GROUP=512 -DBRICK_GROUP=64 -DLANES=1 -DRUN=8 -DPREFETCHES=0'

# check FILE FLAG...: a header through a file that includes nothing else. Messages of one file stay together, and the first
# file that fails ends the run.
check() {
    local file=$1 input=(-x cl "$1") messages
    shift
    [[ $file == *.h ]] && input=(-include "$file" -x cl /dev/null)
    messages=$("${CLANG:-clang}" -cl-std=CL1.2 -Xclang -finclude-default-header -Wall -Wextra -pedantic -Werror -fsyntax-only \
        -I . "$@" "${input[@]}" 2>&1) || {
        printf 'kernels/cl/%s with %s:\n%s\n' "$file" "$*" "$messages"
        return 255 # ends xargs
    }
}
export -f check

combinations() {
    local file setting type store
    for file in *.cl lib/*.h; do
        for setting in "$cpu" "$gpu"; do
            for type in uchar char ushort short float; do
                store=convert_${type}_sat_rte
                [[ $type != float ]] || store=convert_float
                [[ $file == *.h && $type != float ]] || echo "$file --target=spir64 -DSAMPLE=$type -DSTORE=$store $setting"
            done
            [[ $file != derive.cl && $file != lib/steps.h && $file != lib/neighbourhood.h ]] ||
                echo "$file --target=spir64 -DSAMPLE=float -DUNEVEN $setting"
            [[ $file == *.h ]] || echo "$file --target=amdgcn -nogpulib -DSAMPLE=float -DSTORE=convert_float $setting"
        done
    done
}
combinations | xargs -P "$(nproc)" -L 1 bash -c 'check "$@"' check
