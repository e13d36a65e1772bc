# Completes groups and options of `python -m experiments.NAME ...` in bash. Type
#   eval "$(python -m experiments.identify --shell-completion)"
# or put that line into ~/.bashrc; in zsh, `autoload -U bashcompinit; bashcompinit` before it.
_miho() {
  local line="${COMP_LINE:0:COMP_POINT}" conf=@CONF@ word group value before
  [[ "$line" == *"-m experiments."*" "* ]] || return
  word="${line##* }"
  if [[ "$word" == *=* ]]; then  # bash breaks words at =, so only what is behind it is completed
    group="${word%%=*}" value="${word#*=}"
    before="${value%"${value##*,}"}"  # of several values, as in optimizer=miho,pso_100
    COMPREPLY=($(compgen -P "$before" -W "$(cd "$conf/$group" 2>/dev/null &&
      printf '%s\n' *.yaml | sed 's/\.yaml$//')" -- "${value##*,}"))
  else
    COMPREPLY=($(compgen -S = -W "$(cd "$conf" && printf '%s\n' */ | tr -d /) seed root fresh \
      budget.evaluations budget.seconds sweep.workers sweep.dry_run" -- "$word"))
    compopt -o nospace 2>/dev/null
  fi
}
complete -o default -F _miho python python3
