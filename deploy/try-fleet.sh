#!/usr/bin/env bash
# A fleet on one machine: four containers play a site's server and three robots. In a clone, with Docker; the images take
# minutes to build. `deploy/try-fleet.sh remove` takes everything away again.
set -euo pipefail
machine() { EIGENSCAN_NETWORK=container:$1 EIGENSCAN_FOLDER=$PWD/fleet/$2 docker-compose -f deploy/fleet.yml -p "$1" --profile "$3" $4; }
if [ "${1:-}" = remove ]; then
  for robot in r17 r18 r19; do machine $robot robots/$robot robot down; done
  machine site site site down
  docker rm -f site r17 r18 r19 r17-driver r18-driver r19-driver
  docker network rm air
  exit
fi
docker-compose --profile demo build
eigenscan fleet certify --site hospital --address site --robot r17 --robot r18 --robot r19 -o fleet
cp -r deploy/maps fleet/site/maps && sudo chown -R 10001 fleet/site fleet/robots
docker network create air
for machine in site r17 r18 r19; do
  docker run -d --init --name $machine --network air "${EIGENSCAN_BASE:-python:3.11-slim-bookworm}" sleep infinity
done
machine site site site "up -d"
for robot in r17 r18 r19; do
  machine $robot robots/$robot robot "up -d"
  docker run -d --name $robot-driver --network container:$robot --tmpfs /var/cache/eigenscan:uid=10001 -v $PWD/deploy/maps:/maps:ro \
    -v $PWD/fleet/robots/$robot:/etc/eigenscan:ro eigenscan/simulator --map=/maps/map.yaml --zenoh=/etc/eigenscan/service.json5 \
    --site=hospital --robot=$robot --seconds=600
done
docker run --rm -u $(id -u) --network air -v $PWD/fleet/operator:/etc/eigenscan:ro --entrypoint eigenscan eigenscan/simulator \
  fleet status --site hospital --zenoh /etc/eigenscan/operator.json5 --once     # after a minute: 3 of 3 robots localized
docker network disconnect air r17      # out of reach: it keeps localizing
docker network connect air r17
