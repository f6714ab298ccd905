# lib.sh - shared by tools/demo and tools/check; bash, in the project's root.

# The compiler cache needs a folder that can be written; a CI user may have no home.
if [ -z "${CCACHE_DIR:-}" ] && { [ -z "${HOME:-}" ] || [ ! -w "$HOME" ]; }; then
  export CCACHE_DIR="$PWD/.cache/ccache"
fi

# step TITLE COMMAND...: runs it, says how long it took, and answers with its exit code. A shell function as COMMAND must
# chain its parts by && or `|| return`: whoever asks for the exit code (step ... ||) switches `set -e` off within.
step() {
  local title=$1 start=$SECONDS status=0
  shift
  printf '\n== %s\n' "$title"
  "$@" || status=$?
  if [ "$status" -ne 0 ]; then
    printf '== %s: FAILED after %d s (exit code %d)\n' "$title" $((SECONDS - start)) "$status" >&2
    return "$status"
  fi
  printf '== %s: %d s\n' "$title" $((SECONDS - start))
}
skip() { printf '\n== %s\n' "$1"; }

# configureOnce PRESET FOLDER [OPTION...]: CMake itself sees to later changes of its files.
configureOnce() {
  local preset=$1 folder=$2
  shift 2
  if [ -f "$folder/build.ninja" ] && [ "$(cat "$folder/.options" 2>/dev/null)" = "$*" ]; then
    printf 'configured before\n'
    return 0
  fi
  cmake --preset "$preset" -B "$folder" "$@" &&
    printf '%s\n' "$*" >"$folder/.options"
}
