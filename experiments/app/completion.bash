# Completes groups and options of `python -m experiments.NAME ...` in bash, also your own after
# `--config-dir FOLDER`. Type
#   eval "$(python -m experiments.identify --shell-completion)"
# or put that line into ~/.bashrc; in zsh, `autoload -U bashcompinit; bashcompinit` before it.
_miho() {
  local line="${COMP_LINE:0:COMP_POINT}" word group value before folder
  local folders=(@CONF@)
  [[ "$line" == *"-m experiments."*" "* ]] || return
  word="${line##* }"
  for folder in $(grep -oE -- '(--config-dir|-cd)[ =]+[^ ]+ ' <<<"$line" | sed 's/^[^ =]*[ =]*//'); do
    folders+=("${folder/#\~/$HOME}")
  done
  if [[ "$word" == *=* ]]; then  # bash breaks words at =, so only what is behind it is completed
    group="${word%%=*}" value="${word#*=}"
    before="${value%"${value##*,}"}"  # of several values, as in optimizer=miho,pso_100
    COMPREPLY=($(compgen -P "$before" -W "$(for folder in "${folders[@]}"; do
      (cd "$folder/$group" 2>/dev/null && { find . -name '*.yaml' | sed 's/^..//; s/\.yaml$//'
        sed '1d; s/,.*//' *.csv 2>/dev/null; })
    done | sort -u)" -- "${value##*,}"))
  else
    COMPREPLY=($(compgen -S = -W "$(for folder in "${folders[@]}"; do
      (cd "$folder" 2>/dev/null && printf '%s\n' */ | tr -d /)
    done | sort -u) seed root fresh budget.evaluations budget.seconds sweep.workers sweep.dry_run" -- "$word"))
    compopt -o nospace 2>/dev/null
  fi
}
complete -o default -F _miho python python3
