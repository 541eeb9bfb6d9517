# A computer without Docker, but with systemd: /opt/eigenscan holds what docs/fleet.md has pip install there.
ARG IMAGES
FROM ${IMAGES}/recorder AS recorder
FROM ${IMAGES}/simulator
USER 0:0
RUN apt-get -o Acquire::Retries=5 update -q && apt-get -o Acquire::Retries=5 install -y -q --no-install-recommends systemd && apt-get clean
COPY --from=recorder /opt/eigenscan /opt/eigenscan
RUN echo /opt/own > /opt/eigenscan/lib/python3.11/site-packages/eigenscan.pth \
 && ln -s /opt/own/bin/eigenscan* /opt/eigenscan/bin/
ENTRYPOINT ["/lib/systemd/systemd"]
