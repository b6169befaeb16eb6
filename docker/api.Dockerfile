# The web API. From the repository's root: docker build --file docker/api.Dockerfile --tag multicap-api .
FROM node:24-bookworm-slim AS portal
WORKDIR /portal
COPY api/portal/package.json api/portal/package-lock.json api/portal/vendor.mjs ./
RUN npm ci --no-audit --no-fund

FROM python:3.11-slim-bookworm AS build
WORKDIR /src
RUN python -m venv /opt/multicap
COPY docker/requirements.lock .
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps --require-hashes --only-binary :all: -r requirements.lock
COPY hatch_build.py pyproject.toml README.md ./
COPY api api
COPY --from=portal /portal/vendor api/portal/vendor
COPY multicap multicap
COPY pipeline pipeline
COPY worker worker
RUN /opt/multicap/bin/pip install --no-cache-dir --no-deps .

FROM python:3.11-slim-bookworm
RUN useradd --uid 10001 --create-home multicap && install --directory --owner multicap /data
COPY --from=build /opt/multicap /opt/multicap
ENV PATH=/opt/multicap/bin:$PATH \
    MULTICAP_DATA_DIR=/data \
    MULTICAP_HOST=0.0.0.0 \
    MULTICAP_TRUST_NETWORK=true
USER 10001
VOLUME /data
EXPOSE 8000
HEALTHCHECK --interval=10s --timeout=5s --start-period=20s \
    CMD ["python", "-P", "-c", "import urllib.request; urllib.request.urlopen('http://127.0.0.1:8000/healthz', timeout=4)"]
CMD ["python", "-P", "-m", "multicap.api"]
