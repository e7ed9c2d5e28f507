#!/bin/sh
# Stands for a C compiler and archiver where there is none: an empty file where theirs would be. What it "builds" cannot be linked.
while [ $# -gt 0 ]; do
  case "$1" in -o) shift; : > "$1";; *.a) : > "$1";; esac
  shift
done
exit 0
