#!/bin/sh
# The tour of `make demo`, each command shown before it runs.
#
#     tools/demo.sh BIN FOLDER
#
# BIN is the bin/ of the virtual environment; parts, lake and pictures are made in FOLDER.
set -eu

bin=$1
demo=$2
lake=$demo/lake
sheet=$demo/models.png
mkdir -p "$demo"

heading() { printf '\n== %s\n' "$*"; }

# run COMMAND ARGUMENT...: print it as one would type it, and run it from the environment.
run() {
    command=$1
    shift
    printf '$ %s' "$command"
    for argument in "$@"; do
        case $argument in
        *[!A-Za-z0-9_./=-]*) printf ' "%s"' "$argument" ;;
        *) printf ' %s' "$argument" ;;
        esac
    done
    printf '\n'
    "$bin/$command" "$@"
}

heading "Model sample parts as STEP files"
run breplake samples "$demo/parts"

heading "Ingest them: exact B-Rep tables, meshes, ground truth"
run breplake ingest "$demo/parts" --lake "$lake" --message "sample parts"

heading "Which models have more than 30 torus patches?"
run breplake sql "
    SELECT name, n_torus, n_patches, round(area) AS area_mm2
    FROM models
    WHERE n_torus > 30
    ORDER BY n_torus DESC" --lake "$lake"

heading "Stream one batch of point clouds into torch"
run python examples/what_does_a_training_loop_get.py "$lake"

heading "Draw the models, patches coloured by type"
run python examples/what_do_the_models_look_like.py "$lake" "$sheet"
name=$("$bin/breplake" sql "SELECT name FROM models ORDER BY n_torus DESC, name LIMIT 1" \
    --lake "$lake" --format csv | tail -n 1)
run breplake show "$name" --lake "$lake" -o "$demo/model.png"

cat <<EOF

Done. Look at
    $sheet    all sample parts
    $demo/model.png     $name
and try next
    . $bin/activate
    export BREPLAKE=$lake
    breplake info
    breplake check
    breplake sql "SELECT type, count(*) AS patches, sum(area) AS mm2 FROM patches GROUP BY type"
    breplake ingest FOLDER_WITH_STEP_FILES --collection mine
EOF
