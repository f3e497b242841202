"""LeRobot sets from and to the Hugging Face Hub, by huggingface_hub (extra `hub`)."""

from candata.hub.address import HubAddress, is_hub_address, parse_address
from candata.hub.card import dataset_card, stated_licences
from candata.hub.downloads import HubSet, download_set
from candata.hub.uploads import push_set

__all__ = [
    "HubAddress",
    "HubSet",
    "dataset_card",
    "download_set",
    "is_hub_address",
    "parse_address",
    "push_set",
    "stated_licences",
]
