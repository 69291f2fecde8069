#!/usr/bin/env bash
# Makes a certificate authority, a server and a client certificate for mutual TLS: for development and single-host
# installations. Usage: make-certificates.sh DIR [SERVER_NAME...]   (names or addresses; default: localhost 127.0.0.1)
# Existing files are kept, so that a second call changes nothing.
set -euo pipefail
dir=${1:?usage: make-certificates.sh DIR [SERVER_NAME...]}
shift
names=("$@")
((${#names[@]})) || names=(localhost 127.0.0.1)
mkdir -p "$dir"
cd "$dir"
umask 077
alt=""
for name in "${names[@]}"; do
  [[ $name =~ ^[0-9.]+$ || $name == *:* ]] && alt+="IP:$name," || alt+="DNS:$name,"
done
[[ -f ca.key ]] || openssl req -x509 -newkey rsa:3072 -nodes -days 825 -subj "/CN=Pleat CA" -keyout ca.key -out ca.crt 2>/dev/null
issue() {  # name, subject, extensions
  [[ -f $1.crt ]] && return
  openssl req -newkey rsa:3072 -nodes -subj "$2" -keyout "$1.key" -out "$1.csr" 2>/dev/null
  openssl x509 -req -in "$1.csr" -CA ca.crt -CAkey ca.key -CAcreateserial -days 825 -out "$1.crt" \
    -extfile <(printf '%s\n' "$3") 2>/dev/null
  rm -f "$1.csr"
}
issue server "/CN=${names[0]}" "subjectAltName=${alt%,}"$'\n'"extendedKeyUsage=serverAuth"
issue client "/CN=pleat client" "extendedKeyUsage=clientAuth"
echo "certificates: $PWD"
