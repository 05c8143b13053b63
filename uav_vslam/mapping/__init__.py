# SPDX-License-Identifier: Apache-2.0
"""What was flown over: its surface, orthomosaic and textured model. It reads poses and images; nothing flows back."""
