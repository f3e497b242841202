#!/usr/bin/env bash
# Installs the wheel of a folder in a clean environment of each Python that is here, and runs the quick demo in it.
# Usage: tools/try_wheel.sh FOLDER [VERSION ...]; versions that are not here are named.
set -euo pipefail
folder=$1
shift
versions=("$@")
[ ${#versions[@]} -gt 0 ] || versions=(3.11 3.12 3.13)
# The most that a core installation may take on the disk [MB].
most_mb=620

# Print an interpreter of a version, on the path or of pyenv; nothing where there is none.
interpreter() {
  local candidate
  for candidate in "python$1" "$(pyenv root 2> /dev/null)/versions/$1".*/bin/python; do
    if "$candidate" -c "" 2> /dev/null; then
      echo "$candidate"
      return
    fi
  done
}

tried=0
for version in "${versions[@]}"; do
  python=$(interpreter "$version")
  if [ -z "$python" ]; then
    echo "== Python $version is not here: the wheel is not tried on it"
    continue
  fi
  echo "== the wheel on $("$python" --version)"
  rm -rf "$folder/env" "$folder/out"
  "$python" -m venv "$folder/env"
  "$folder/env/bin/python" -m pip --disable-pip-version-check install --quiet --constraint constraints.txt "$folder"/candata-*.whl
  size_mb=$(du -sm "$folder/env" | cut -f1)
  echo "core installation: $size_mb MB"
  [ "$size_mb" -le "$most_mb" ]
  (cd "$folder" && env/bin/candata --version && env/bin/candata demo --quick --json > demo.json)
  grep '"outcome": "found"' "$folder/demo.json"
  rm -rf "$folder/env"
  tried=$((tried + 1))
done
echo "the wheel works on $tried of ${#versions[@]} versions of Python"
[ "$tried" -gt 0 ]
