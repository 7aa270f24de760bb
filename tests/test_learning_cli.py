"""`learn`, and `estimate` and `validate` with what it made, from the command line."""

import csv
import json

import numpy as np
import pytest
from in_process import run
from machine_logs import as_csv, machine_log
