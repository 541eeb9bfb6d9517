# One image for each service. Those that compute alike share the layer of what they need from others:
#   docker build --target projector -t eigenscan/projector .
# Targets: router, scan-ingest, projector, tracker, mapbuilder, ros-bridge, recorder, robot-recorder, simulator.
# A service takes its settings from flags (docker run IMAGE --site hospital), EIGENSCAN_* variables or a mounted TOML file.
# BASE by digest, so that no registry can change it: docs/docker.md.
ARG BASE=python:3.11-slim-bookworm

# --- what builds and installs; it is in no image ---
FROM ${BASE} AS tools
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_ROOT_USER_ACTION=ignore PIP_QUIET=1
COPY deploy/requirements /requirements
RUN python -m venv /tools && python -m venv --without-pip /opt/eigenscan \
 && /tools/bin/pip install --require-hashes -r /requirements/build.lock

# --- our own packages, one folder for each service ---
FROM tools AS own
COPY . /src
WORKDIR /src
RUN /tools/bin/pip wheel --no-deps --no-build-isolation -w /wheels ./schemas ./geometry ./eigenspace ./runtime ./services/* ./library ./workbench ./fleet ./cli \
 && for service in router scan-ingest projector tracker mapbuilder ros-bridge recorder; do \
      set -- /wheels/eigenscan_schemas-* /wheels/eigenscan_geometry-* /wheels/eigenscan_eigenspace-* /wheels/eigenscan_runtime-*; \
      own=/wheels/eigenscan_$(echo $service | tr - _)-*; [ $service = router ] || set -- "$@" $own; \
      /tools/bin/pip --python /opt/eigenscan/bin/python install --no-deps --no-index --no-compile --target /own/$service "$@"; \
    done \
 && /tools/bin/pip --python /opt/eigenscan/bin/python install --no-deps --no-index --no-compile --target /own/simulator /wheels/* \
 && find /own -name '*.py' -exec touch -d "@$(date +%s)" {} + && /opt/eigenscan/bin/python -m compileall -q /own

# --- what every image has: a user without rights, its folders, a probe ---
FROM ${BASE} AS shell
RUN groupadd --system --gid 10001 eigenscan \
 && useradd --system --uid 10001 --gid 10001 --no-create-home --home-dir /tmp eigenscan \
 && install -d -o eigenscan -g eigenscan /recordings /models /var/cache/eigenscan
ENV PATH=/opt/own/bin:/opt/eigenscan/bin:$PATH PYTHONPATH=/opt/own PYTHONUNBUFFERED=1 HOME=/tmp OMP_NUM_THREADS=1 \
    NUMBA_CACHE_DIR=/var/cache/eigenscan EIGENSCAN_METRICS_PORT=9100 EIGENSCAN_METRICS_HOST=0.0.0.0
USER 10001:10001
WORKDIR /tmp
EXPOSE 9100
HEALTHCHECK --interval=5s --timeout=4s --start-period=1200s --retries=3 CMD ["python", "-IS", "-c", \
  "import os, urllib.request as r; r.urlopen('http://127.0.0.1:%s/healthz' % os.environ['EIGENSCAN_METRICS_PORT'], timeout=3)"]

# --- layer: lean ---
FROM tools AS lean-files
RUN /tools/bin/pip --python /opt/eigenscan/bin/python install --no-deps --require-hashes -r /requirements/lean.lock
FROM shell AS lean
COPY --from=lean-files /opt/eigenscan /opt/eigenscan

FROM lean AS router
COPY --from=own /own/router /opt/own
ENTRYPOINT ["eigenscan-router"]

# --- layer: numeric ---
FROM lean-files AS numeric-files
RUN /tools/bin/pip --python /opt/eigenscan/bin/python install --no-deps --require-hashes -r /requirements/numeric.lock
FROM shell AS numeric
COPY --from=numeric-files /opt/eigenscan /opt/eigenscan

# --- what numba compiles, so that no container's first start does; a machine with another processor compiles anew.
# numba goes by the age of the sources: it is the same in all images, in whole seconds, as images are stored ---
FROM numeric AS compiled
ARG BUILDARCH
ARG TARGETARCH
COPY --from=own /own/simulator /opt/own
RUN [ "$BUILDARCH" != "$TARGETARCH" ] || python -c "import eigenscan.ingest.core, eigenscan.tracker.core, eigenscan.projector.warm_up as projector; \
projector.warm_up(projector.ProjectorSettings())"

FROM numeric AS scan-ingest
COPY --from=compiled --chown=10001:10001 /var/cache/eigenscan /var/cache/eigenscan
COPY --from=own /own/scan-ingest /opt/own
ENTRYPOINT ["eigenscan-scan-ingest"]

FROM numeric AS projector
COPY --from=compiled --chown=10001:10001 /var/cache/eigenscan /var/cache/eigenscan
COPY --from=own /own/projector /opt/own
ENTRYPOINT ["eigenscan-projector"]

FROM numeric AS tracker
COPY --from=compiled --chown=10001:10001 /var/cache/eigenscan /var/cache/eigenscan
COPY --from=own /own/tracker /opt/own
ENTRYPOINT ["eigenscan-tracker"]

FROM numeric AS mapbuilder
COPY --from=compiled --chown=10001:10001 /var/cache/eigenscan /var/cache/eigenscan
COPY --from=own /own/mapbuilder /opt/own
ENTRYPOINT ["eigenscan-mapbuilder"]

FROM numeric AS ros-bridge
COPY --from=own /own/ros-bridge /opt/own
ENTRYPOINT ["eigenscan-ros-bridge"]

# a robot's, which draws nothing: with the layer that the robot's other services have
FROM numeric AS robot-recorder
COPY --from=own /own/recorder /opt/own
ENTRYPOINT ["eigenscan-recorder"]

# the whole command but for what draws: a simulated robot, or docker run --entrypoint eigenscan IMAGE evaluate ...,
# or a robot's services in one process: --entrypoint eigenscan-together
FROM numeric AS simulator
COPY --from=compiled --chown=10001:10001 /var/cache/eigenscan /var/cache/eigenscan
COPY --from=own /own/simulator /opt/own
HEALTHCHECK NONE
ENTRYPOINT ["eigenscan", "simulate", "--live"]

# --- layer: recording ---
FROM lean-files AS recorder-files
RUN /tools/bin/pip --python /opt/eigenscan/bin/python install --no-deps --require-hashes -r /requirements/recorder.lock
FROM shell AS recording
COPY --from=recorder-files /opt/eigenscan /opt/eigenscan

FROM recording AS recorder
COPY --from=own /own/recorder /opt/own
ENTRYPOINT ["eigenscan-recorder"]
