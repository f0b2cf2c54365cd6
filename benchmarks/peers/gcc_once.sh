#!/bin/sh
# Run gcc as it is asked to, `OPTIONS -c SOURCE -o OBJECT`, but once for each source and beside it: an integrator has the
# same functions at every tolerance.
object=$(eval "echo \"\${$#}\"")
source=$(eval "echo \"\${$(($# - 2))}\"")
kept="once-$(cksum < "$source" | tr ' ' '-').o"
[ -f "$kept" ] || gcc "$@" || exit
[ -f "$kept" ] || cp "$object" "$kept"
cp "$kept" "$object"
