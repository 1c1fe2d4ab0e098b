#compdef gr-wiforce
# SPDX-License-Identifier: GPL-3.0-or-later
eval "$(_GR_WIFORCE_COMPLETE=zsh_source gr-wiforce)"
