#!/usr/bin/env bash
# Prints an interpreter of Python 3.12, which LeRobot 0.6 needs: the first of python3.12 on the path,
# pyenv's, uv's and the distribution's that runs. An error says where it looked.
set -euo pipefail

candidates() {
    echo python3.12
    if command -v pyenv >/dev/null; then
        compgen -G "$(pyenv root)/versions/3.12*/bin/python3.12" || true
    fi
    if command -v uv >/dev/null; then
        uv python find 3.12 2>/dev/null || true
    fi
    echo /usr/bin/python3.12
}

while read -r python; do
    # pyenv puts commands on the path that only say which versions would have them.
    if found="$("$python" -c 'import sys, venv; print(sys.executable)' 2>/dev/null)"; then
        echo "$found"
        exit
    fi
done < <(candidates)
echo "python312: no Python 3.12 on the path, nor among pyenv's, uv's or the distribution's; name one with PYTHON312=" >&2
exit 1
