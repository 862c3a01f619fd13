#!/bin/bash
# Healthy when /healthz answers 200. Bash speaks TCP: no curl in the image for one line of HTTP. HEALTH_PORT: where it is
# answered without TLS.
exec 3<>"/dev/tcp/127.0.0.1/${HEALTH_PORT:-8417}" || exit 1
printf 'GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n' >&3
read -r -t 5 _ status _ <&3 && [ "$status" = 200 ]
