# The dashboard in a container:
#   docker build -t wattlane .
#   docker run --rm -p 127.0.0.1:8050:8050 -v wattlane-runs:/data -e WATTLANE_TOKEN=choose-one wattlane
FROM python:3.12-slim-bookworm AS build

ENV PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1
WORKDIR /src
RUN python -m venv /opt/wattlane
# The packages change seldom, the program often: two layers.
COPY requirements.lock ./
RUN /opt/wattlane/bin/python -m pip install --no-cache-dir --require-hashes --only-binary :all: -r requirements.lock
COPY pyproject.toml LICENSE README.md ./
COPY assets ./assets
COPY engine ./engine
COPY app ./app
RUN /opt/wattlane/bin/python -m pip install --no-cache-dir --no-index --no-deps --no-build-isolation .


FROM python:3.12-slim-bookworm

RUN groupadd --system --gid 10001 wattlane \
    && useradd --system --uid 10001 --gid wattlane --create-home wattlane \
    && install --directory --owner wattlane --group wattlane /data
COPY --from=build /opt/wattlane /opt/wattlane
# Beyond loopback the dashboard starts only with a token, so WATTLANE_TOKEN must be given to the container.
ENV PATH=/opt/wattlane/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    NUMBA_CACHE_DIR=/data/.cache/numba \
    WATTLANE_CACHE=/data/.cache/wattlane \
    WATTLANE_DATA=/data
USER 10001:10001
WORKDIR /data
VOLUME /data
EXPOSE 8050
HEALTHCHECK --interval=30s --timeout=5s --start-period=60s --retries=3 \
    CMD ["python", "-c", "import urllib.request as r; r.urlopen('http://127.0.0.1:8050/healthz', timeout=4)"]
ENTRYPOINT ["wattlane"]
CMD ["dashboard", "--host", "0.0.0.0", "--port", "8050", "--no-browser"]
