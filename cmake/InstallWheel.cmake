# SPDX-License-Identifier: GPL-3.0-or-later
# What `pip install .` installs: destinations are relative to the folder of Python packages.
#
# There is no gnuradio/__init__.py among it. Without GNU Radio, Python takes the folder for a
# namespace package; GNU Radio's own __init__.py adds such folders to its __path__.
set(package gnuradio/wiforce)
set(without_caches PATTERN __pycache__ EXCLUDE PATTERN bindings EXCLUDE)

install(DIRECTORY python/wiforce/ DESTINATION ${package} FILES_MATCHING PATTERN *.py ${without_caches})
install(DIRECTORY gr-wiforce/wiforce_app gr-wiforce/software_n210 DESTINATION . ${without_caches})
# Inside the package: where pip places shared files depends on the system.
install(DIRECTORY gr-wiforce/scenes gr-wiforce/sensors gr-wiforce/data DESTINATION ${package}/share
  ${without_caches})
set(DATA_FROM_PACKAGE share)
configure_file(cmake/_config.py.in ${PROJECT_BINARY_DIR}/install/_config.py @ONLY)
install(FILES ${PROJECT_BINARY_DIR}/install/_config.py DESTINATION ${package})

install(FILES docs/gr-wiforce.1 DESTINATION ${SKBUILD_DATA_DIR}/share/man/man1)
install(FILES gr-wiforce/completions/gr-wiforce.bash RENAME gr-wiforce
  DESTINATION ${SKBUILD_DATA_DIR}/share/bash-completion/completions)
install(FILES gr-wiforce/completions/gr-wiforce.zsh RENAME _gr-wiforce
  DESTINATION ${SKBUILD_DATA_DIR}/share/zsh/site-functions)
install(FILES gr-wiforce/completions/gr-wiforce.fish
  DESTINATION ${SKBUILD_DATA_DIR}/share/fish/vendor_completions.d)
