# The simulation half: evolution, learning, build packets, the virtual rig, reports. No ROS, no devices.
#
#   docker build -f docker/simulation.Dockerfile -t eldir .
#   docker run --rm -v "$PWD:/work" --user "$(id -u):$(id -g)" eldir demo --out demo

FROM python:3.12-slim-bookworm AS build
COPY . /source
RUN python -m venv /opt/eldir \
    && /opt/eldir/bin/pip install --no-cache-dir -c /source/.ci/constraints.txt '/source[mujoco,watch]'

FROM python:3.12-slim-bookworm
COPY --from=build /opt/eldir /opt/eldir
# Any user may run it: compiled kernels and figures' fonts are kept in HOME.
ENV PATH=/opt/eldir/bin:$PATH HOME=/tmp
WORKDIR /work
USER 1000:1000
RUN ["eldir", "--version"]
ENTRYPOINT ["eldir"]
CMD ["--help"]
