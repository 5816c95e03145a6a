# The server beside a ROS 2 of its own, for robots that are reached over the network of the host:
#   docker build -t ros2-mcp .
#   docker run -i --rm --network host --ipc host -v ros2-mcp:/data ros2-mcp
# How, and what works where: docs/how-to/docker.md
ARG ROS_DISTRO=jazzy

FROM ros:${ROS_DISTRO}-ros-base AS build
# Versions are those of the distribution's image.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install -y --no-install-recommends python3-venv \
    && rm -rf /var/lib/apt/lists/*
COPY pyproject.toml README.md LICENSE /source/
COPY src /source/src
RUN python3 -m venv /opt/ros2-mcp && /opt/ros2-mcp/bin/pip install --no-cache-dir /source

FROM ros:${ROS_DISTRO}-ros-base AS server
LABEL io.modelcontextprotocol.server.name="io.github.OWNER/ros2-mcp" \
    org.opencontainers.image.version="0.1.0" \
    org.opencontainers.image.source="https://github.com/OWNER/ros2-mcp" \
    org.opencontainers.image.licenses="Apache-2.0"
# Packages of ROS to add, such as another middleware: --build-arg ROS_PACKAGES="ros-jazzy-rmw-cyclonedds-cpp"
ARG ROS_PACKAGES=""
# hadolint ignore=DL3008,SC2086
RUN if [ -n "$ROS_PACKAGES" ]; then \
        apt-get update \
        && apt-get install -y --no-install-recommends $ROS_PACKAGES \
        && rm -rf /var/lib/apt/lists/*; \
    fi
COPY --from=build /opt/ros2-mcp /opt/ros2-mcp
COPY deploy/docker/entrypoint.sh /opt/ros2-mcp/bin/entrypoint
# State (latch, audit, token), recordings and ROS's logs are in /data, for whatever user runs it.
RUN install -d -m 1777 /data
ENV PATH=/opt/ros2-mcp/bin:$PATH HOME=/data
WORKDIR /data
ENTRYPOINT ["/opt/ros2-mcp/bin/entrypoint"]

# The simulated robot and the tour: docker build -t ros2-mcp-demo --target demo . && docker run -it --rm ros2-mcp-demo
FROM server AS demo
CMD ["demo"]

# What is built without --target.
FROM server
