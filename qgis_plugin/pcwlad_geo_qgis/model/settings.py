"""What the options of QGIS say: which engine, which proxy; and where this profile is."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

from processing.core.ProcessingConfig import ProcessingConfig
from qgis.core import QgsApplication, QgsSettings

from ..process.engine import Engine, locate
from ..process.install import local_base

SETTING = "PCWLAD_GEO_ENGINE"


def private_folder() -> Path:
    """Return the folder that the folders of the plugin's own engines are named after."""
    return local_base(Path(QgsApplication.qgisSettingsDirPath()))


def find_engine() -> Engine:
    """Find the engine, or raise `EngineError`."""
    return locate(ProcessingConfig.getSetting(SETTING) or "", private_folder())


def proxy_variables() -> dict[str, str]:
    """Return the proxy of QGIS's network options as variables of an environment; none if there is none."""
    settings = QgsSettings()
    names = ("proxyHost", "proxyPort", "proxyUser", "proxyPassword")
    host, port, user, password = (str(settings.value(f"proxy/{name}", "") or "") for name in names)
    if not settings.value("proxy/proxyEnabled", False, type=bool) or not host:
        return {}
    scheme = "socks5h" if settings.value("proxy/proxyType", "") == "Socks5Proxy" else "http"
    login = f"{quote(user, safe='')}:{quote(password, safe='')}@" if user else ""
    url = f"{scheme}://{login}{host}" + (f":{port}" if port else "")
    variables = dict.fromkeys(("HTTP_PROXY", "HTTPS_PROXY", "http_proxy", "https_proxy"), url)
    excluded = settings.value("proxy/noProxyUrls", []) or []
    names = [excluded] if isinstance(excluded, str) else list(excluded)
    hosts = [str(each).split("://")[-1].split("/")[0] for each in names]
    return {**variables, **({"NO_PROXY": ",".join(hosts), "no_proxy": ",".join(hosts)} if hosts else {})}
