#!/usr/bin/env bash
# A certificate authority for mutual TLS: for development and single-host installations.
#   make-certificates.sh DIR [SERVER_NAME...]      the authority, a server (names or addresses; default: localhost
#                                                  127.0.0.1), a client and an empty revocation list
#   make-certificates.sh DIR --client NAME [ROLE]  one more client, client-NAME.crt: admin, user (default) or watcher
#   make-certificates.sh DIR --renew FILE          FILE.crt anew with a new key (server, client, client-NAME)
#   make-certificates.sh DIR --revoke FILE         FILE.crt does not count any more: ca.crl says so
# Existing files are kept, so that a second call changes nothing. Whoever has ca.key can make themselves anybody: keep DIR
# where the authority lives. A service gets DIR/service (ca.crt, ca.crl, server.crt, server.key, and health.crt,
# health.key for its own health check), which every call brings up to date; a client gets ca.crt and its own two files.
set -euo pipefail
self=$(realpath "${BASH_SOURCE[0]}")
usage() {
  sed -n '3,7s/^# *//p' "$self" >&2
  exit 2
}
dir=${1:-}
[[ -n $dir && $dir != -* ]] || usage
shift
umask 077
mkdir -p "$dir"
cd "$dir"
days=825
key=(-newkey ec -pkeyopt ec_paramgen_curve:prime256v1 -nodes)

prepare() {
  [[ -f ca.key ]] || openssl req -x509 "${key[@]}" -days $days -subj "/CN=Pleat CA" \
    -addext keyUsage=critical,keyCertSign,cRLSign -keyout ca.key -out ca.crt 2>/dev/null
  [[ -f revoked.txt ]] || : >revoked.txt
  [[ -f ca.crl ]] || list
}
authority() {  # what `openssl ca` must be told to keep a revocation list
  openssl ca -config <(printf '%s\n' '[ca]' 'default_ca = own' '[own]' "database = $PWD/revoked.txt" \
    'default_md = sha256' "default_crl_days = $days" 'unique_subject = no') -cert ca.crt -keyfile ca.key "$@" 2>/dev/null
}
list() {
  authority -gencrl -out ca.crl.new
  mv ca.crl.new ca.crl
}
sign() {  # file, subject, extensions: both files appear together, after all else
  openssl req "${key[@]}" -subj "$2" -keyout "$1.key.new" -out "$1.csr" 2>/dev/null
  openssl x509 -req -in "$1.csr" -CA ca.crt -CAkey ca.key -CAcreateserial -days $days -out "$1.crt.new" \
    -extfile <(printf '%s\n' "$3") 2>/dev/null
  rm -f "$1.csr"
  mv "$1.key.new" "$1.key"
  mv "$1.crt.new" "$1.crt"
}
issue() { [[ -f $1.crt ]] || sign "$@"; }
known() { [[ -f $1.crt ]] || { echo "make-certificates.sh: $PWD has no $1.crt" >&2; exit 2; }; }

case ${1:-} in
--client)
  name=${2:-} role=${3:-user}
  [[ $name =~ ^[A-Za-z0-9][A-Za-z0-9._@-]{0,63}$ && $role =~ ^(admin|user|watcher)$ ]] || usage
  prepare
  issue "client-$name" "/OU=$role/CN=$name" "extendedKeyUsage=clientAuth"
  ;;
--renew)
  known "${2:?}"
  subject=/$(openssl x509 -in "$2.crt" -noout -subject -nameopt sep_multiline,utf8,esc_2253 | sed -n 's/^ *//; 2,$p' | paste -sd/)
  alt=$(openssl x509 -in "$2.crt" -noout -ext subjectAltName 2>/dev/null | sed -n '2{s/IP Address:/IP:/g; s/ //g; p}')
  if [[ -n $alt ]]; then extensions="subjectAltName=$alt"$'\n'"extendedKeyUsage=serverAuth"; else extensions="extendedKeyUsage=clientAuth"; fi
  sign "$2" "$subject" "$extensions"
  ;;
--revoke)
  known "${2:?}"
  prepare
  authority -revoke "$2.crt"
  list
  ;;
-*) usage ;;
*)
  names=("$@")
  ((${#names[@]})) || names=(localhost 127.0.0.1)
  alt=""
  for name in "${names[@]}"; do
    [[ $name =~ ^[0-9.]+$ || $name == *:* ]] && alt+="IP:$name," || alt+="DNS:$name,"
  done
  prepare
  issue server "/CN=${names[0]}" "subjectAltName=${alt%,}"$'\n'"extendedKeyUsage=serverAuth"
  issue client "/OU=user/CN=pleat client" "extendedKeyUsage=clientAuth"
  issue health "/OU=watcher/CN=pleat health check" "extendedKeyUsage=clientAuth"
  ;;
esac
if [[ -f server.crt ]]; then
  mkdir -p service
  for file in ca.crt ca.crl server.key server.crt health.key health.crt; do
    cmp -s $file service/$file && continue
    cp $file service/$file.new
    mv service/$file.new service/$file
  done
fi
echo "certificates: $PWD"
